"""The robots of a run as designs, whatever the run was for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from eldir.core.files import read_json
from eldir.core.version import __version__
from eldir.design import Design
from eldir.evolution.printed.run_folder import PrintedRun, PrintedRunFile
from eldir.evolution.run_folder import RunFile, RunFolder
from eldir.evolution.search import printed_terrain, robot_seed
from eldir.learning import learn
from eldir.scene import Scene

Run = RunFolder | PrintedRun
_MAX_PRINTED = 24
"""Elites of a run for building that become designs, the best first: a shortlist holds at most twelve."""


def open_run(path: Path | str) -> Run:
    """Open the folder of a run of either kind. Raises `InputError` with the missing or damaged file."""
    path = Path(path)
    known: dict[str, type[RunFolder] | type[PrintedRun]]
    known = {RunFile.FORMAT: RunFolder, PrintedRunFile.FORMAT: PrintedRun}
    values = read_json(path / "run.json", RunFile.FORMAT, tuple(known))
    return known[values["format"]].open(path)


def load_run(path: Path | str, count: int | None = None) -> list[Design]:
    """The robots of the last complete generation as designs, best first: the survivors of a run in the
    paper's scene, or the elites of a run for building, which carry their gaits. `count`: the largest number
    of designs; by default all of a run in the paper's scene, and 24 of a run for building.

    Robots that evolved on a terrain are built for it. Raises `InputError` where no generation is complete.
    """
    run = open_run(path)
    run.require_generations()
    if isinstance(run, PrintedRun):
        return _printed_designs(run, _MAX_PRINTED if count is None else count)
    return _trained_designs(run)[:count]


def _trained_designs(run: RunFolder) -> list[Design]:
    """The survivors of a run in the paper's scene. Their provenance holds fitness, generation and seed."""
    search = run.restore()
    assert search.survivors is not None  # a generation is complete
    config, robots = run.config, search.survivors.robots
    terrain = printed_terrain(config.scene)
    return [
        Design(
            config.lattice,
            genotype,
            controller,
            config.scene,
            printed_terrain=terrain,
            provenance={
                "fitness_m": float(fitness),
                "generation": int(number) // config.population,
                "id": int(number),
                "parents": [int(p) for p in parents if p >= 0],
                "seed": int(seed),
                "run_seed": config.seed,
                "version": __version__,
                "training": config.training.to_json(),
                **({"built_walk": float(walk)} if config.second_stage else {}),
            },
        )
        for genotype, controller, fitness, number, parents, seed, walk in zip(
            robots.genotypes,
            search.survivors.controllers,
            search.survivors.fitness(),
            robots.ids,
            robots.parents,
            robots.seeds,
            search.survivors.walks,
            strict=True,
        )
    ]


def _printed_designs(run: PrintedRun, count: int) -> list[Design]:
    """The best elites of a run for building, with gait and expected walk in their provenance.

    The closed-loop rollout is one of the three motions of a report. A printed robot evolves without a
    controller, so the elites are trained here, on the run's terrain; the same run always gives the same
    controllers.
    """
    config, scene = run.config, Scene()
    if config.terrain is not None:
        scene = scene.replace(terrain=config.terrain.scaled(1 / config.printed.scale))
    elites = run.restore().archive.ranked()[:count]
    if not elites:
        return []
    bodies = [w.genome.body(config.lattice) for w in elites]
    seeds = [robot_seed(config.seed, w.generation, w.number) for w in elites]
    trained = learn(bodies, scene, seed=seeds)
    return [
        Design(
            config.lattice,
            walker.genome.genotype,
            controller,
            scene,
            printed_terrain=config.terrain,
            # A robot that diverged at once in the closed loop has no fitness in it.
            provenance=({"fitness_m": -float(losses.min())} if np.isfinite(losses).any() else {})
            | {
                "generation": walker.generation,
                "id": walker.number,
                "parents": [walker.parent] if walker.parent >= 0 else [],
                "seed": seed,
                "run_seed": config.seed,
                "version": __version__,
                "evolved_walk": {
                    "expected": walker.expected,
                    "standard_error": walker.error,
                    "samples": len(walker.walks),
                },
                "gait": walker.genome.gait(body, config.timings).to_json(),
            },
        )
        for walker, body, controller, losses, seed in zip(
            elites, bodies, trained.controllers, trained.losses, seeds, strict=True
        )
    ]
