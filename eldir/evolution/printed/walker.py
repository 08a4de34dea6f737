"""Printed robots in the archive: their niche, the walks of their samples, and the fitness by which they are
ranked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from eldir.built.samples import RISK
from eldir.core.records import FloatArray, Record
from eldir.evolution.printed.genome import PrintedGenome
from eldir.lattice import HALF_SIDE
from eldir.morphology import Morphology

_ON_GROUND = 1e-9


class Niche(NamedTuple):
    """A cell of the archive: bodies of the same size with as many motors at the ground."""

    rows: int
    """Rows of triangles."""
    length: int
    """Length in pitches."""
    masses: int
    grounded: int
    """Motors at the ground."""


@dataclass(frozen=True, eq=False)
class Walker(Record):
    """A printed robot and the walks of its samples."""

    number: int
    """Unique in a run."""
    parent: int
    """Number of its parent; -1 for a random one."""
    generation: int
    genome: PrintedGenome
    niche: Niche
    walks: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Walks of samples 0, 1, ... [body lengths per five cycles], a fall counted as 0, shape (n,)."""

    def __post_init__(self) -> None:
        self._set_array("walks", np.float64, (None,))

    @property
    def samples(self) -> int:
        """Number of samples whose walks are known."""
        return len(self.walks)

    @property
    def expected(self) -> float:
        """Mean walk of the samples [body lengths per five cycles]."""
        return float(self.walks.mean()) if len(self.walks) else -np.inf

    @property
    def error(self) -> float:
        """Standard error of the expected walk."""
        n = len(self.walks)
        return float(self.walks.std(ddof=1)) / float(np.sqrt(n)) if n > 1 else np.inf

    @property
    def fitness(self) -> float:
        """Lower confidence bound by which walkers are ranked: the expected walk less half the standard
        deviation of the walks."""
        return self.expected - RISK * float(self.walks.std(ddof=1)) if len(self.walks) > 1 else -np.inf

    def with_walks(self, further: FloatArray) -> Walker:
        """The same walker with further samples."""
        return replace(self, walks=np.concatenate([self.walks, further]))


def find_niche(body: Morphology) -> Niche:
    """The niche of a body."""
    width, height = np.ptp(body.positions, axis=0)
    low = body.positions[:, 1] < body.positions[:, 1].min() + _ON_GROUND
    grounded = low[body.springs[body.active]].any(axis=1)
    rows, length = height / (np.sqrt(3) * HALF_SIDE), width / (2 * HALF_SIDE)
    return Niche(round(rows), round(length), len(body.positions), int(grounded.sum()))


def group_by_size(ranked: Sequence[Walker], min_ratio: float) -> list[list[Walker]]:
    """The elites of each size (number of hubs), the best first, of sizes whose best one has at least this
    part of the best fitness of all."""
    sizes: dict[int, list[Walker]] = {}
    for walker in ranked:
        sizes.setdefault(walker.niche.masses, []).append(walker)
    groups = list(sizes.values())
    threshold = min_ratio * groups[0][0].fitness
    return [own for own in groups if own is groups[0] or own[0].fitness >= threshold]
