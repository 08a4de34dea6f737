"""The robots of a run as designs, whatever the run was for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from eldir.core.files import read_json
from eldir.core.version import __version__
from eldir.design import Design
from eldir.errors import InputError
from eldir.evolution.own.run_folder import ProblemRun
from eldir.evolution.own.vectors import ProblemConfig
from eldir.evolution.paper.configuration import EvolutionConfig, printed_terrain, robot_seed
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.learning import learn
from eldir.scene import Scene

Run = RunFolder | PrintedRun | ProblemRun
RunConfiguration = EvolutionConfig | PrintedEvolutionConfig | ProblemConfig
_MAX_PRINTED = 24
"""Elites of a run for building that become designs, the best first: a shortlist holds at most twelve."""


def create_run(path: Path, config: RunConfiguration) -> Run:
    """Make a new run folder. Raises `EldirError` where the path exists already."""
    if isinstance(config, EvolutionConfig):
        return RunFolder.create(path, config)
    if isinstance(config, PrintedEvolutionConfig):
        return PrintedRun.create(path, config)
    return ProblemRun.create(path, config)


def open_run(path: Path | str) -> Run:
    """Open the folder of a run of any kind. Raises `InputError` with the missing or damaged file."""
    path = Path(path)
    known: dict[str, type[RunFolder] | type[PrintedRun] | type[ProblemRun]]
    known = {kind.FILE.FORMAT: kind for kind in (RunFolder, PrintedRun, ProblemRun)}
    values = read_json(path / "run.json", RunFolder.FILE.FORMAT, tuple(known))
    return known[values["format"]].open(path)


def require_robots(run: Run) -> RunFolder | PrintedRun:
    """The run itself. Raises `InputError` for a run of an own problem: it has no designs and no figures."""
    if isinstance(run, ProblemRun):
        raise InputError(
            f"{run.path} has no robots",
            code="run.no-robots",
            found=f"solutions of the problem {run.config.problem}",
            remedy="read them in Python: ProblemRun.open(folder).read_last_elites()",
        )
    return run


def load_run(path: Path | str, count: int | None = None) -> list[Design]:
    """The robots of the last complete generation as designs, best first: the survivors of a run in the
    paper's scene, or the elites of a run for building, which carry their gaits. `count`: the largest number
    of designs; by default all of a run in the paper's scene, and 24 of a run for building.

    Robots that evolved on a terrain are built for it. Raises `InputError` where no generation is complete.
    """
    run = require_robots(open_run(path))
    run.require_generations()
    if isinstance(run, PrintedRun):
        return _printed_designs(run, _MAX_PRINTED if count is None else count)
    return _trained_designs(run)[:count]


def _trained_designs(run: RunFolder) -> list[Design]:
    """The survivors of a run in the paper's scene. Their provenance holds fitness, generation and seed."""
    config = run.config
    terrain = printed_terrain(config.scene)
    return [
        Design(
            config.lattice,
            robot.genotype,
            robot.controller,
            config.scene,
            printed_terrain=terrain,
            provenance={
                "fitness_m": robot.fitness,
                "generation": robot.number // config.population,
                "id": robot.number,
                "parents": [p for p in robot.parents if p >= 0],
                "seed": robot.seed,
                "run_seed": config.seed,
                "version": __version__,
                "training": config.training.to_json(),
                **({"built_walk": robot.walk} if config.second_stage else {}),
            },
        )
        for robot in run.read_last_elites()
        if robot.controller is not None
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
    elites = run.read_last_elites()[:count]
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
