"""Variation of printed robots: random ones, and offspring by small changes of body, motors and gait.

Every offspring has one parent. Its body changes as in the paper (bits flipped with p = 1/n), or a motor
moves, or the body gets other room on the lattice, or only its gait changes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eldir.core.records import BoolArray, IntArray
from eldir.evolution.printed.genome import PrintedGenome
from eldir.evolution.printed.placement import moved
from eldir.evolution.variation import mutate_bodies, mutate_springs
from eldir.genotype import Genotype, repair_bodies, repair_springs, unstack
from eldir.lattice import Lattice

_PHASE_STEP = 0.08
"""Standard deviation of a change of phase, as a fraction of the period: the peak of a walk over the phase is
about 0.1 wide (docs/reference/evolution.md)."""
_OPERATORS = {"body": 0.45, "motor": 0.25, "gait": 0.2, "place": 0.1}
_ELSEWHERE = 0.3  # probability that a motor moves anywhere, not to a neighbour
_OTHER_TIMING = 0.3
_MOST_UP, _MOST_RIGHT = 2, 4
_WINDOW = (2, 3), (3, 6)  # least and most rows and columns of triangles of random robots (decision 45)


def random_genomes(
    lattice: Lattice, n: int, rng: np.random.Generator, max_active: int, timings: int
) -> list[PrintedGenome]:
    """Random bodies, motors and phases. Each body fills half of a window of 2 or 3 by 3 to 6 triangles:
    smaller bodies do not walk; larger ones seldom do, and take longer to simulate."""
    triangles = rng.random((n, lattice.rows, lattice.columns)) < 0.5
    for i in range(n):
        triangles[i] &= _window(lattice, rng)
        if not triangles[i].any():
            triangles[i, rng.integers(lattice.rows), rng.integers(lattice.columns)] = True
    bodies = repair_bodies(lattice, triangles)
    springs = repair_springs(lattice, bodies, rng.random((n, len(lattice.springs))) < 0.5, rng, max_active)
    return [
        PrintedGenome(genotype, rng.random(len(lattice.springs)), int(rng.integers(timings)))
        for genotype in unstack(bodies, springs)
    ]


def _window(lattice: Lattice, rng: np.random.Generator) -> BoolArray:
    """A random rectangle of the lattice, of a size in which robots walk, shape (rows, columns)."""
    inside = np.ones((lattice.rows, lattice.columns), bool)
    for axis, room in enumerate((lattice.rows, lattice.columns)):
        least, most = _WINDOW[axis]
        size = int(rng.integers(min(least, room), min(most, room) + 1))
        first = int(rng.integers(room - size + 1))
        index = np.arange(room)
        within = (index >= first) & (index < first + size)
        inside &= within[:, None] if axis == 0 else within
    return inside


def offspring(
    lattice: Lattice, parent: PrintedGenome, rng: np.random.Generator, max_active: int, timings: int
) -> PrintedGenome:
    """One offspring that differs from its parent in one of the four ways."""
    while True:
        child = _changed(lattice, parent, rng, max_active, timings)
        if child != parent:  # flipped bits may be repaired to the same robot
            return child


def _changed(
    lattice: Lattice, parent: PrintedGenome, rng: np.random.Generator, max_active: int, timings: int
) -> PrintedGenome:
    kind = str(rng.choice(list(_OPERATORS), p=list(_OPERATORS.values())))
    if kind == "place" and (elsewhere := _shifted(lattice, parent, rng)) is not None:
        parent = elsewhere  # other room: what may grow there is the change
        kind = "body"
    if kind == "motor":
        return _with_moved_motor(lattice, parent, rng, max_active)
    if kind == "gait":
        return _with_changed_gait(lattice, parent, rng, timings)
    bodies = mutate_bodies(lattice, parent.genotype.triangles[None], rng)
    springs = repair_springs(lattice, bodies, parent.genotype.springs[None], rng, max_active)
    return replace(parent, genotype=Genotype(bodies[0], springs[0]))


def _with_moved_motor(
    lattice: Lattice, parent: PrintedGenome, rng: np.random.Generator, max_active: int
) -> PrintedGenome:
    """One motor moves to another spring, mostly to one that shares a mass with it, and takes its phase along;
    or bits flip as in the paper, so that the number of motors may change."""
    body, springs = parent.genotype.triangles, parent.genotype.springs
    expressed = np.flatnonzero(lattice.expressed_springs(body))
    motors = expressed[springs[expressed]]
    passive = expressed[~springs[expressed]]
    chosen = int(rng.choice(motors))
    near = passive[_touching(lattice, chosen, passive)]
    if rng.random() < _ELSEWHERE or not len(near):
        near = passive
    if not len(near) or rng.random() < 1 / (1 + len(motors)):
        flipped = mutate_springs(
            lattice, body[None], _with_one_flipped(springs, expressed, rng), rng, max_active
        )
        return replace(parent, genotype=Genotype(body, flipped[0]))
    to = int(rng.choice(near))
    changed, phases = springs.copy(), parent.phases.copy()
    changed[chosen], changed[to] = False, True
    phases[to] = phases[chosen]
    return replace(parent, genotype=Genotype(body, changed), phases=phases)


def _with_one_flipped(springs: np.ndarray, expressed: IntArray, rng: np.random.Generator) -> np.ndarray:
    changed = springs.copy()
    changed[int(rng.choice(expressed))] ^= True
    return changed[None]


def _touching(lattice: Lattice, spring: int, others: IntArray) -> np.ndarray:
    """Which of the other springs share a vertex with this one."""
    shared = np.isin(lattice.springs[others], lattice.springs[spring])
    return np.asarray(shared.any(axis=1), bool)


def _with_changed_gait(
    lattice: Lattice, parent: PrintedGenome, rng: np.random.Generator, timings: int
) -> PrintedGenome:
    """Other phases of all motors; sometimes another period too."""
    expressed = lattice.expressed_springs(parent.genotype.triangles)
    motors = np.flatnonzero(expressed & parent.genotype.springs)
    phases, timing = parent.phases.copy(), parent.timing
    phases[motors] = (phases[motors] + _PHASE_STEP * rng.standard_normal(len(motors))) % 1.0
    if timings > 1 and rng.random() < _OTHER_TIMING:
        timing = int(rng.integers(timings))
    return replace(parent, phases=phases, timing=timing)


def _shifted(lattice: Lattice, parent: PrintedGenome, rng: np.random.Generator) -> PrintedGenome | None:
    up = int(rng.integers(-_MOST_UP, _MOST_UP + 1))
    right = int(rng.integers(-_MOST_RIGHT, _MOST_RIGHT + 1))
    return moved(lattice, parent, right + (right + up) % 2, up)
