"""Populations: robots before and after learning, and which of them survive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_count
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop_all


@dataclass(frozen=True, eq=False)
class Robots(Record):
    """N robots before learning."""

    genotypes: tuple[Genotype, ...]
    ids: IntArray
    """Ids: generation * population + index, unique in a run, shape (N,)."""
    parents: IntArray
    """Ids of both progenitors, shape (N, 2): equal where there was one, -1 where there was none."""
    seeds: IntArray
    """Seed of each robot's initial weights, shape (N,)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "genotypes", tuple(self.genotypes))
        n = len(self.genotypes)
        self._set_array("ids", np.int64, (n,))
        self._set_array("parents", np.int64, (n, 2))
        self._set_array("seeds", np.int64, (n,))

    def take(self, index: IntArray) -> Robots:
        """The robots with these indices, in this order."""
        genotypes = tuple(self.genotypes[i] for i in index)
        return Robots(genotypes, self.ids[index], self.parents[index], self.seeds[index])

    def morphologies(self, lattice: Lattice) -> list[Morphology]:
        """The developed bodies."""
        return develop_all(lattice, self.genotypes)


@dataclass(frozen=True, eq=False)
class LearnedRobots(Record):
    """N robots after learning."""

    robots: Robots
    losses: FloatArray
    """Losses before the first update and after each [m], shape (N, iterations + 1)."""
    controllers: tuple[Controller, ...]
    """The controller with the least loss of each robot."""
    walks: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Walk as built, in body lengths per five cycles, shape (N,); empty if no robot was simulated as built.
    NaN: not simulated; minus infinity: fell or folded."""
    chaotic_updates: IntArray = field(default_factory=lambda: np.zeros(0, int))
    """Updates of each robot whose gradient chaos dominates (`eldir.engine.validity`), shape (N,). -1: not
    known, because an older version trained it; so for all if empty."""
    rounded_updates: IntArray = field(default_factory=lambda: np.zeros(0, int))
    """Updates of each robot whose gradient rounding may dominate, shape (N,); -1: not known."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "controllers", tuple(self.controllers))
        n = len(self.robots.genotypes)
        self._set_array("losses", np.float64, (n, None))
        if not len(self.walks):
            object.__setattr__(self, "walks", np.full(n, np.nan))
        self._set_array("walks", np.float64, (n,))
        for name in ("chaotic_updates", "rounded_updates"):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.full(n, -1))
            self._set_array(name, np.int32, (n,))
        require_count("controllers", len(self.controllers), len(self.losses))

    def fitness(self) -> FloatArray:
        """Greatest net displacement over all iterations [m], shape (N,)."""
        return -self.losses.min(axis=1)

    def take(self, index: IntArray) -> LearnedRobots:
        """The robots with these indices, in this order."""
        trained = tuple(self.controllers[i] for i in index)
        return LearnedRobots(
            self.robots.take(index),
            self.losses[index],
            trained,
            self.walks[index],
            self.chaotic_updates[index],
            self.rounded_updates[index],
        )

    def join(self, other: LearnedRobots) -> LearnedRobots:
        """These robots, then the others."""
        a, b = self.robots, other.robots
        robots = Robots(
            a.genotypes + b.genotypes,
            *(np.concatenate([getattr(a, k), getattr(b, k)]) for k in ("ids", "parents", "seeds")),
        )
        return LearnedRobots(
            robots,
            np.concatenate([self.losses, other.losses]),
            self.controllers + other.controllers,
            *(
                np.concatenate([getattr(self, k), getattr(other, k)])
                for k in ("walks", "chaotic_updates", "rounded_updates")
            ),
        )


class LearningOutcome(Protocol):
    """Protocol of the results that `Search.tell` takes, such as `eldir.learning.LearningResult`."""

    @property
    def losses(self) -> FloatArray:
        """Losses before the first update and after each [m], shape (N, iterations + 1)."""

    @property
    def controllers(self) -> Sequence[Controller]:
        """The controller with the least loss of each robot."""

    @property
    def chaotic_updates(self) -> IntArray:
        """Updates of each robot whose gradient chaos dominates, shape (N,)."""

    @property
    def rounded_updates(self) -> IntArray:
        """Updates of each robot whose gradient rounding may dominate, shape (N,)."""


def flagged_share(updates: IntArray, iterations: int) -> float:
    """Share of the updates of some robots that have a flag, of which `updates` has the number for each robot.
    NaN where it is known of none."""
    known = updates[updates >= 0]
    return float(known.mean()) / iterations if len(known) else float("nan")


def is_valid(losses: FloatArray, jump_threshold: float) -> BoolArray:
    """Whether each robot is valid, shape (N,): all losses are finite, and no change between two iterations is
    above the threshold [m]. This is the only place where results are discarded."""
    with np.errstate(invalid="ignore"):
        jumps = np.abs(np.diff(losses, axis=1)).max(axis=1, initial=0.0)
        return np.isfinite(losses).all(axis=1) & (jumps <= jump_threshold)


def select(pool: LearnedRobots, n: int, jump_threshold: float) -> LearnedRobots:
    """The best `n` valid robots that did not fall as built, best first; of equal ones, the older first."""
    standing = pool.walks != -np.inf
    sound = pool.take(np.flatnonzero(is_valid(pool.losses, jump_threshold) & standing))
    return sound.take(np.argsort(-sound.fitness(), kind="stable")[:n])
