"""The history of a run, read from its generation files: which robots survived, and how well they learned.

Selection is repeated from the losses, so that the run folder holds only the evaluated robots.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.errors import InputError
from eldir.evolution.paper.population import flagged_share
from eldir.evolution.paper.run_folder import RunFolder, load_generation
from eldir.genotype import Genotype


@dataclass(frozen=True)
class EvaluatedRobots:
    """Some robots of a run, with the values that figures need."""

    ids: IntArray
    """Ids of the robots, shape (N,)."""
    parents: IntArray
    """Ids of both progenitors, shape (N, 2); -1: none."""
    seeds: IntArray
    """Seeds of the initial weights, shape (N,)."""
    triangles: BoolArray
    """Filled triangles, shape (N, rows, columns)."""
    springs: BoolArray
    """Active bits of the lattice springs, shape (N, lattice springs)."""
    initial: FloatArray
    """Displacement before learning [m], shape (N,)."""
    fitness: FloatArray
    """Greatest displacement over all iterations [m], shape (N,)."""
    sizes: IntArray
    """Number of springs, shape (N,)."""
    active: FloatArray
    """Share of the springs that are motors, shape (N,)."""
    chaotic: IntArray
    """Updates whose gradient chaos dominates (`eldir.engine.validity`), shape (N,); -1: not known."""
    rounded: IntArray
    """Updates whose gradient rounding may dominate, shape (N,); -1: not known."""

    def take(self, index: IntArray | BoolArray) -> EvaluatedRobots:
        """The robots with these indices, or where the mask is true."""
        return EvaluatedRobots(*(getattr(self, name)[index] for name in EvaluatedRobots.__dataclass_fields__))

    def join(self, other: EvaluatedRobots) -> EvaluatedRobots:
        """These robots, then the others."""
        return EvaluatedRobots(
            *(
                np.concatenate([getattr(p, k) for p in (self, other)])
                for k in EvaluatedRobots.__dataclass_fields__
            )
        )

    def genotype(self, i: int) -> Genotype:
        """The genotype of robot `i`."""
        return Genotype(self.triangles[i], self.springs[i])


@dataclass(frozen=True)
class Trend:
    """Values of the population at every generation, each of shape (G,)."""

    best_initial: FloatArray
    """Displacement of the fittest before it learned [m]."""
    best: FloatArray
    mean_initial: FloatArray
    sd_initial: FloatArray
    mean: FloatArray
    sd: FloatArray
    size: FloatArray
    """Mean number of springs."""
    active: FloatArray
    """Mean share of motors."""
    evaluated: FloatArray
    """Robots that learned in the generation."""
    discarded: FloatArray
    """Number of unstable ones among them."""
    chaotic: FloatArray
    """Share of the updates whose gradient chaos dominates; NaN where an older version trained all robots."""
    rounded: FloatArray
    """Share of the updates whose gradient rounding may dominate; NaN likewise."""


@dataclass(frozen=True)
class RunHistory:
    """A run from the random progenitors to its last complete generation."""

    run: RunFolder
    trend: Trend
    progenitors: EvaluatedRobots
    """All random robots that were valid."""
    first: EvaluatedRobots
    """The population after the first generation, best first."""
    last: EvaluatedRobots
    """The last population, best first."""
    best: tuple[EvaluatedRobots, ...]
    """The best robot after each generation."""
    line: tuple[EvaluatedRobots, ...]
    """The best robot and its ancestors, youngest first; of two progenitors, the fitter is followed."""


def read_history(run: RunFolder, progress: Callable[[int], None] = lambda done: None) -> RunHistory:
    """Repeat the selections of a run. `progress` is called with the number of generations that are read."""
    whole = run.require_generations()
    rows: list[tuple[float, ...]] = []
    origin: dict[int, EvaluatedRobots] = {}
    best: list[EvaluatedRobots] = []
    alive: EvaluatedRobots | None = None
    for generation in range(whole[-1][0] + 1):
        born, sound, stands = _load_evaluated(run, generation)
        if alive is None:
            progenitors = born.take(sound)
        elif not np.isin(born.parents, alive.ids).all():
            raise InputError(
                f"{run.generation_file(generation)} does not follow from the generations before",
                code="run.broken-history",
                expected="offspring of the robots that survived",
                remedy="restore the run's own files",
            )
        lives = born.take(sound & stands)
        pool = lives if alive is None else alive.join(lives)
        alive = pool.take(np.argsort(-pool.fitness, kind="stable")[: run.config.population])
        for i in np.flatnonzero(np.isin(alive.ids, born.ids)):
            origin[int(alive.ids[i])] = alive.take(np.array([i]))
        if generation == 0:
            first = alive
        best.append(alive.take(np.array([0])))
        flagged = [flagged_share(one, run.config.iterations) for one in (alive.chaotic, alive.rounded)]
        rows.append((*_trend_row(alive, len(sound), int((~sound).sum())), *flagged))
        progress(generation + 1)
    assert alive is not None
    trend = Trend(*np.array(rows).T)
    return RunHistory(
        run, trend, progenitors, first, alive, tuple(best), _trace_ancestors(int(alive.ids[0]), origin)
    )


def _load_evaluated(run: RunFolder, generation: int) -> tuple[EvaluatedRobots, BoolArray, BoolArray]:
    """The robots that learned in a generation; whether each is valid; and whether it did not fall as
    built."""
    kept = load_generation(run.path, generation)
    expressed = run.config.lattice.expressed_springs(kept["triangles"])
    sizes = expressed.sum(axis=1)
    losses = kept["losses"]
    sound = kept["valid"]
    fitness = np.where(sound, -losses.min(axis=1, initial=np.inf, where=np.isfinite(losses)), np.nan)
    active = (expressed & kept["springs"]).sum(axis=1) / sizes
    robots = EvaluatedRobots(
        kept["id"], kept["parents"], kept["seed"], kept["triangles"], kept["springs"],
        -losses[:, 0], fitness, sizes, active, kept["chaotic_updates"], kept["rounded_updates"],
    )  # fmt: skip
    return robots, sound, kept["walk"] != -np.inf


def _trend_row(alive: EvaluatedRobots, evaluated: int, discarded: int) -> tuple[float, ...]:
    return (
        alive.initial[0], alive.fitness[0],
        alive.initial.mean(), alive.initial.std(), alive.fitness.mean(), alive.fitness.std(),
        alive.sizes.mean(), alive.active.mean(), evaluated, discarded,
    )  # fmt: skip


def _trace_ancestors(youngest: int, origin: dict[int, EvaluatedRobots]) -> tuple[EvaluatedRobots, ...]:
    line = [origin[youngest]]
    while (parents := line[-1].parents[0]).min() >= 0:
        known = [origin[int(p)] for p in parents]
        line.append(max(known, key=lambda robot: float(robot.fitness[0])))
    return tuple(line)
