"""Robots of the paper's scene before and after learning, and which of them are valid."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from eldir.controller import Controller
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.genotype import Genotype


@dataclass(frozen=True, eq=False)
class Robot(Record):
    """A robot; without losses before it has learned."""

    number: int
    """Its id: generation * population + index, unique in a run."""
    parents: tuple[int, int]
    """Ids of both progenitors: equal where there was one, -1 where there was none."""
    seed: int
    """Seed of the initial weights."""
    genotype: Genotype
    losses: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Losses before the first update and after each [m], shape (iterations + 1,)."""
    controller: Controller | None = None
    """The controller with the least loss."""
    walk: float | None = None
    """Walk as built [body lengths per five cycles]. None: not simulated; minus infinity: fell or folded."""
    chaotic_updates: int = -1
    """Updates whose gradient chaos dominates (`eldir.engine.validity`). -1: not known, because an older
    version trained it."""
    rounded_updates: int = -1
    """Updates whose gradient rounding may dominate; -1: not known."""

    genome: Any = None
    """What the encoding varies (`eldir.evolution.paper.encoding`). None: the genotype itself."""

    niche = ()
    samples = 1

    @cached_property
    def fitness(self) -> float:
        """Greatest net displacement over all iterations [m]."""
        return -float(self.losses.min())


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
