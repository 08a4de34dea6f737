"""Bodies elsewhere on the lattice, or as mirror images: the same robot with other room to grow."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from eldir.core.records import BoolArray, IntArray
from eldir.evolution.printed.genome import PrintedGenome
from eldir.genotype import Genotype
from eldir.lattice import Lattice


def moved(lattice: Lattice, genome: PrintedGenome, right: int, up: int) -> PrintedGenome | None:
    """The genome with its body shifted by lattice units (`right` + `up` even); None if it does not fit."""
    return _mapped(lattice, genome, 1, right, up)


def mirrored(lattice: Lattice, genome: PrintedGenome) -> PrintedGenome:
    """The genome of the mirror image, which walks the other way with the same gait. It stays as near to its
    place as the lattice allows; on a lattice of one column a body that has no mirror image stays."""
    for right in sorted(range(2 * lattice.columns + 1), key=lambda by: abs(by - (lattice.columns - 1))):
        if (found := _mapped(lattice, genome, -1, right, 0)) is not None:
            return found
    return genome


def _mapped(lattice: Lattice, genome: PrintedGenome, turn: int, right: int, up: int) -> PrintedGenome | None:
    """Every vertex from (x, y) to (`turn` x + `right`, y + `up`)."""
    triangles, springs = _maps(lattice, turn, right, up)
    filled = genome.genotype.triangles.ravel()
    if (triangles[filled] < 0).any():
        return None
    body: BoolArray = np.zeros_like(filled)
    body[triangles[filled]] = True
    known = springs >= 0
    active, phases = genome.genotype.springs.copy(), genome.phases.copy()
    active[springs[known]] = genome.genotype.springs[known]
    phases[springs[known]] = genome.phases[known]
    return replace(
        genome, genotype=Genotype(body.reshape(genome.genotype.triangles.shape), active), phases=phases
    )


@lru_cache(maxsize=512)
def _maps(lattice: Lattice, turn: int, right: int, up: int) -> tuple[IntArray, IntArray]:
    """Where each triangle and each spring goes, -1 for those that leave the lattice."""
    number = {(int(x), int(y)): i for i, (x, y) in enumerate(lattice.vertices)}
    to = [number.get((turn * int(x) + right, int(y) + up), -1) for x, y in lattice.vertices]
    return _placed(lattice.triangles, to), _placed(lattice.springs, to)


def _placed(groups: IntArray, to: list[int]) -> IntArray:
    """Index of the group of vertices to which each group goes, -1 where there is none."""
    index = {tuple(sorted(map(int, group))): i for i, group in enumerate(groups)}
    return np.array([index.get(tuple(sorted(to[v] for v in group)), -1) for group in groups], np.int64)
