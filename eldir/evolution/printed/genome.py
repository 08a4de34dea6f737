"""Genomes of printed robots: random ones, and offspring by small changes of body, motors and gait.

A genome holds a body, its motors, and when each motor is heated.

Every offspring has one parent. Its body changes as in the paper (bits flipped with p = 1/n), or a motor
moves, or the body gets other room on the lattice, or only its gait changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from eldir.built.gait import Gait
from eldir.built.gait_search import EVOLVED
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.evolution.variation import mutate_bodies, mutate_springs
from eldir.genotype import Genotype, repair_bodies, repair_springs, unstack
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop

_PHASE_STEP = 0.055
"""Standard deviation of a change of phase, as a fraction of the period: the peak of a walk over the phase is
about two seconds wide (docs/reference/evolution.md)."""
_OPERATORS = {"body": 0.45, "motor": 0.25, "gait": 0.2, "place": 0.1}
_ELSEWHERE = 0.3  # probability that a motor moves anywhere, not to a neighbour
_OTHER_TIMING = 0.3
_MAX_UP, _MAX_RIGHT = 2, 4
_WINDOW = (2, 3), (3, 6)  # least and most rows and columns of triangles of random robots (decision 45)


class Timing(NamedTuple):
    """Times of heating that a rig allows."""

    period: float
    """Period of the gait [s]."""
    heating: float
    """How long a motor is heated in each period [s]."""


@dataclass(frozen=True, eq=False)
class PrintedGenome(Record):
    """Genes of one printed robot."""

    genotype: Genotype
    phases: FloatArray
    """Start of heating of each lattice spring, as a fraction of the period, shape (lattice springs,). It is
    expressed where the spring is a motor."""
    timing: int
    """Index of the period and heating time in the run's list of them."""

    def __post_init__(self) -> None:
        self._set_array("phases", np.float64, (len(self.genotype.springs),))

    def body(self, lattice: Lattice) -> Morphology:
        """The developed body."""
        return develop(lattice, self.genotype)

    def gait(self, body: Morphology, timings: Sequence[Timing]) -> Gait:
        """The gait of the expressed motors; the first one begins at 0."""
        period, heating = timings[self.timing]
        own = self.phases[motor_springs(body)]
        return Gait(period, (own - own[0]) % 1.0, np.full(len(own), heating / period), EVOLVED)


def motor_springs(body: Morphology) -> np.ndarray:
    """Lattice springs of the motors, in the order of the body's springs, shape (A,)."""
    return body.lattice_springs[body.active]


def shift_genome(lattice: Lattice, genome: PrintedGenome, right: int, up: int) -> PrintedGenome | None:
    """The genome with its body shifted by lattice units (`right` + `up` even); None if it does not fit."""
    return _mapped(lattice, genome, 1, right, up)


def mirror_genome(lattice: Lattice, genome: PrintedGenome) -> PrintedGenome:
    """The genome of the mirror image, which walks the other way with the same gait. It stays as near to its
    place as the lattice allows; on a lattice of one column a body that has no mirror image stays."""
    for right in sorted(range(2 * lattice.columns + 1), key=lambda by: abs(by - (lattice.columns - 1))):
        if (found := _mapped(lattice, genome, -1, right, 0)) is not None:
            return found
    return genome


def _mapped(lattice: Lattice, genome: PrintedGenome, turn: int, right: int, up: int) -> PrintedGenome | None:
    """Every vertex from (x, y) to (`turn` x + `right`, y + `up`)."""
    triangles, springs = _index_maps(lattice, turn, right, up)
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
def _index_maps(lattice: Lattice, turn: int, right: int, up: int) -> tuple[IntArray, IntArray]:
    """Where each triangle and each spring goes, -1 for those that leave the lattice."""
    number = {(int(x), int(y)): i for i, (x, y) in enumerate(lattice.vertices)}
    to = [number.get((turn * int(x) + right, int(y) + up), -1) for x, y in lattice.vertices]
    return _index_map(lattice.triangles, to), _index_map(lattice.springs, to)


def _index_map(groups: IntArray, to: list[int]) -> IntArray:
    """Index of the group of vertices to which each group goes, -1 where there is none."""
    index = {tuple(sorted(map(int, group))): i for i, group in enumerate(groups)}
    return np.array([index.get(tuple(sorted(to[v] for v in group)), -1) for group in groups], np.int64)


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


def make_offspring(
    lattice: Lattice, parent: PrintedGenome, rng: np.random.Generator, max_active: int, timings: int
) -> PrintedGenome:
    """One offspring that differs from its parent in one of the four ways."""
    while True:
        child = _vary(lattice, parent, rng, max_active, timings)
        if child != parent:  # flipped bits may be repaired to the same robot
            return child


def _vary(
    lattice: Lattice, parent: PrintedGenome, rng: np.random.Generator, max_active: int, timings: int
) -> PrintedGenome:
    kind = str(rng.choice(list(_OPERATORS), p=list(_OPERATORS.values())))
    if kind == "place" and (elsewhere := _random_shift(lattice, parent, rng)) is not None:
        parent = elsewhere  # other room: what may grow there is the change
        kind = "body"
    if kind == "motor":
        return _move_motor(lattice, parent, rng, max_active)
    if kind == "gait":
        return _change_gait(lattice, parent, rng, timings)
    bodies = mutate_bodies(lattice, parent.genotype.triangles[None], rng)
    springs = repair_springs(lattice, bodies, parent.genotype.springs[None], rng, max_active)
    return replace(parent, genotype=Genotype(bodies[0], springs[0]))


def _move_motor(
    lattice: Lattice, parent: PrintedGenome, rng: np.random.Generator, max_active: int
) -> PrintedGenome:
    """One motor moves to another spring, mostly to one that shares a mass with it, and takes its phase along;
    or bits flip as in the paper, so that the number of motors may change."""
    body, springs = parent.genotype.triangles, parent.genotype.springs
    expressed = np.flatnonzero(lattice.expressed_springs(body))
    motors = expressed[springs[expressed]]
    passive = expressed[~springs[expressed]]
    chosen = int(rng.choice(motors))
    near = passive[_share_vertex(lattice, chosen, passive)]
    if rng.random() < _ELSEWHERE or not len(near):
        near = passive
    if not len(near) or rng.random() < 1 / (1 + len(motors)):
        flipped = mutate_springs(lattice, body[None], _flip_one(springs, expressed, rng), rng, max_active)
        return replace(parent, genotype=Genotype(body, flipped[0]))
    to = int(rng.choice(near))
    changed, phases = springs.copy(), parent.phases.copy()
    changed[chosen], changed[to] = False, True
    phases[to] = phases[chosen]
    return replace(parent, genotype=Genotype(body, changed), phases=phases)


def _flip_one(springs: np.ndarray, expressed: IntArray, rng: np.random.Generator) -> np.ndarray:
    changed = springs.copy()
    changed[int(rng.choice(expressed))] ^= True
    return changed[None]


def _share_vertex(lattice: Lattice, spring: int, others: IntArray) -> np.ndarray:
    """Which of the other springs share a vertex with this one."""
    shared = np.isin(lattice.springs[others], lattice.springs[spring])
    return np.asarray(shared.any(axis=1), bool)


def _change_gait(
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


def _random_shift(lattice: Lattice, parent: PrintedGenome, rng: np.random.Generator) -> PrintedGenome | None:
    up = int(rng.integers(-_MAX_UP, _MAX_UP + 1))
    right = int(rng.integers(-_MAX_RIGHT, _MAX_RIGHT + 1))
    return shift_genome(lattice, parent, right + (right + up) % 2, up)
