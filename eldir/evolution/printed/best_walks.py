"""Walks of the best printed robot every ten generations, for the row of pictures of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.built.gait import free_lengths_batch
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.built.walking import displacements
from eldir.evolution import tables
from eldir.evolution.best_walks import BestWalk, choose_generations
from eldir.evolution.printed.genome import PrintedGenome
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.parameters.robot import RobotParameters

_KEPT_S = 1.0  # between two positions [s]


def printed_walks(run: PrintedRun, whole: int) -> list[BestWalk]:
    """Walks of the robot with the best first estimate until each generation, as printed, over five cycles
    with its gait; none for generations before the first estimate. `whole`: complete generations.

    A run keeps only its last elites, so the robots are those of the first estimates. Their estimates are too
    good, so the walk is simulated: nominal parameters, coarse hubs.
    """
    best = _best_so_far(run, whole)
    chosen = [g for g in choose_generations(whole - 1) if best[g] is not None]
    genomes = [genome for g in chosen if (genome := best[g]) is not None]
    if not genomes:
        return []
    config = run.config
    bodies = [genome.body(config.lattice) for genome in genomes]
    gaits = [genome.gait(body, config.timings) for genome, body in zip(genomes, bodies, strict=True)]
    nominal = RobotParameters(config.printed.with_hubs(), config.springs)
    robots = [build(body, nominal).coarse() for body in bodies]
    heated = [(gait, [config.springs] * body.motors) for gait, body in zip(gaits, bodies, strict=True)]
    heating = free_lengths_batch(heated, hubs=[body.motor_hubs for body in bodies])
    free = config.springs.cold_length, config.springs.hot_length
    distances = displacements(robots, heating, 5, free, terrain=config.terrain)
    interval = heating[0].interval
    every = round(_KEPT_S / interval)
    motions = drive(
        robots, [t.lengths for t in heating], interval, every=every, free=free, terrain=config.terrain
    )
    return [
        BestWalk(
            generation,
            f"{walk:+.2f} body lengths" if np.isfinite(walk) else "falls, folds or buckles a coil",
            body,
            motion.positions[table.first_cycle // every :],
        )
        for generation, walk, body, motion, table in zip(
            chosen, distances, bodies, motions, heating, strict=True
        )
    ]


def _best_so_far(run: PrintedRun, whole: int) -> Sequence[PrintedGenome | None]:
    """The robot with the best first estimate until each generation; None before the first estimate."""
    found: list[PrintedGenome | None] = []
    best, most = None, -np.inf
    for generation in range(whole):
        walks = tables.rows(tables.read(run.generation_file(generation), ["walks"]), "walks")
        means = np.array([own.mean() if len(own) > 1 else -np.inf for own in walks])
        if len(means) and means.max() > most:
            most = float(means.max())
            best = run.read_genome(generation, int(means.argmax()))
        found.append(best)
    return found
