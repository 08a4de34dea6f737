"""Development: from a genotype to masses and springs (paper, Sect. Morphology)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eldir.core.arguments import require_shape
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.errors import InputError
from eldir.genotype import Genotype, component_count, fill, stack
from eldir.lattice import HALF_SIDE, Lattice

_MAX_PLACES = 2**31  # more places than a lattice has in a row or a column
_SPRINGS_AT_ONCE = 2**18  # of the lattices of all bodies that are developed together: what fits into a cache


@dataclass(frozen=True, eq=False)
class Morphology(Record):
    """A body: M masses joined by S springs."""

    positions: FloatArray
    """Rest positions of the masses [m], shape (M, 2), sorted by (x, y)."""
    springs: IntArray
    """Mass indices a < b of every spring, lexicographic, shape (S, 2)."""
    rest_lengths: FloatArray
    """Lengths without force [m], shape (S,)."""
    active: BoolArray
    """Whether a spring is a motor, shape (S,)."""
    vertices: IntArray
    """Lattice vertex of every mass, shape (M,)."""
    lattice_springs: IntArray
    """Lattice spring of every spring, shape (S,)."""

    def __post_init__(self) -> None:
        self._set_array("positions", np.float64, (None, 2))
        masses = len(self.positions)
        self._set_array("springs", np.int32, (None, 2))
        count = len(self.springs)
        self._set_array("rest_lengths", np.float64, (count,))
        self._set_array("active", bool, (count,))
        self._set_array("vertices", np.int32, (masses,))
        self._set_array("lattice_springs", np.int32, (count,))

    @property
    def body_length(self) -> float:
        """Initial horizontal extent of the mass centres [m]."""
        x = self.positions[:, 0]
        return float(x.max() - x.min())

    @property
    def motors(self) -> int:
        """Number of active springs, A."""
        return int(self.active.sum())

    @property
    def motor_hubs(self) -> IntArray:
        """The two masses that each motor joins, shape (A, 2)."""
        return self.springs[self.active]

    @property
    def key(self) -> bytes:
        """Equal for bodies of the same masses, springs and motors, wherever on the lattice they grew."""
        return self.positions.tobytes() + self.springs.tobytes() + self.active.tobytes()

    @property
    def body_key(self) -> bytes:
        """Equal for the same body: the same springs and motors up to a shift and a mirror image, which is the
        same robot seen from behind. Its cells are the same too, because every triangle of springs is one."""
        steps = np.array([HALF_SIDE, np.sqrt(3) * HALF_SIDE])
        grid = np.rint((self.positions - self.positions.min(axis=0)) / steps).astype(np.int64)
        mirrored = grid * [-1, 1] + [grid[:, 0].max(), 0]
        keys = []
        for places in (grid, mirrored):
            ends = np.sort((places @ [_MAX_PLACES, 1])[self.springs], axis=1)
            rows = np.column_stack([ends, self.active])
            keys.append(rows[np.lexsort(rows.T[::-1])].astype("<i8").tobytes())
        return min(keys)

    @property
    def body_name(self) -> str:
        """Eight hexadecimal digits of a digest of `body_key`, which tell bodies of several runs apart."""
        return hashlib.sha256(self.body_key).hexdigest()[:8]


class Bodies:
    """Several bodies, one after the other in the same arrays."""

    def __init__(self, morphologies: Sequence[Morphology]):
        self._all = morphologies
        self.mass_at = offsets([len(m.positions) for m in morphologies])
        """First mass of each body, and the end, shape (n + 1,)."""
        self.spring_at = offsets([len(m.springs) for m in morphologies])
        """First spring of each body, and the end, shape (n + 1,)."""
        self.of_mass, self.of_spring = (
            np.repeat(np.arange(len(at) - 1), np.diff(at)) for at in (self.mass_at, self.spring_at)
        )
        """The body of every mass and of every spring."""

    def __len__(self) -> int:
        return len(self._all)

    def least(self, values: NDArray[Any]) -> NDArray[Any]:
        """For every mass the least value of its body, of one value for each mass."""
        return np.repeat(np.minimum.reduceat(values, self.mass_at[:-1]), np.diff(self.mass_at))

    @cached_property
    def springs(self) -> IntArray:
        """The two masses of every spring, among those of all bodies, shape (S, 2)."""
        return self["springs"] + self.mass_at[self.of_spring][:, None]

    def __getitem__(self, name: str) -> Any:
        """The arrays of this field of all bodies as one."""
        return np.concatenate([getattr(m, name) for m in self._all])


def offsets(sizes: Sequence[int] | IntArray) -> NDArray[np.int32]:
    """Start of each of `n` consecutive pieces, and the end of the last, shape (n + 1,)."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)


def develop(lattice: Lattice, genotype: Genotype) -> Morphology:
    """The body of a repaired genotype, placed at least x = 0.025 m and least y = 0.1 m.

    Raises `InputError` for an empty, unfilled or disconnected body.
    """
    return develop_all(lattice, [genotype])[0]


def develop_all(lattice: Lattice, genotypes: Sequence[Genotype]) -> list[Morphology]:
    """The bodies of many genotypes, as `develop`."""
    for name, wanted in (
        ("triangles", (lattice.rows, lattice.columns)),
        ("springs", (len(lattice.springs),)),
    ):
        for shape in {getattr(g, name).shape for g in genotypes}:
            require_shape(name, shape, wanted)
    at_once = max(1, _SPRINGS_AT_ONCE // len(lattice.springs))
    parts = (genotypes[k : k + at_once] for k in range(0, len(genotypes), at_once))
    return [body for part in parts for body in _develop(lattice, *stack(part))]


def _develop(lattice: Lattice, triangles: BoolArray, acting: BoolArray) -> Iterator[Morphology]:
    _check(lattice, triangles)
    expressed, vertex_count = lattice.expressed_springs(triangles), len(lattice.vertices)
    spring_at = offsets(expressed.sum(axis=1))
    robot = np.repeat(np.arange(len(triangles)), np.diff(spring_at))
    lattice_springs = np.flatnonzero(expressed) - robot * expressed.shape[1]
    ends = lattice.springs[lattice_springs] + vertex_count * robot[:, None]  # among the vertices of all
    present = np.zeros(len(triangles) * vertex_count, bool)
    present[ends] = True
    mass_at = offsets(present.reshape(-1, vertex_count).sum(axis=1))
    vertices = np.flatnonzero(present) % vertex_count
    positions = lattice.positions(vertices, mass_at[:-1])
    springs = (np.cumsum(present)[ends] - 1 - mass_at[robot][:, None]).astype(np.int32)
    rest_lengths = np.full(np.diff(spring_at).max(), 2 * HALF_SIDE)
    active = acting.ravel()[np.flatnonzero(expressed)]
    vertices, lattice_springs = vertices.astype(np.int32), lattice_springs.astype(np.int32)
    for (a, b), (c, d) in zip(pairwise(mass_at.tolist()), pairwise(spring_at.tolist()), strict=True):
        yield Morphology.construct(
            positions[a:b],
            springs[c:d],
            rest_lengths[: d - c],
            active[c:d],
            vertices[a:b],
            lattice_springs[c:d],
        )


def _check(lattice: Lattice, triangles: BoolArray) -> None:
    counts, remedy = component_count(triangles), "repair it with eldir.genotype.repair_bodies"
    if (wrong := counts[counts != 1]).size:
        problem, expected = "the body is not in one piece", "1 connected component"
        found = str(wrong[0])
        raise InputError(problem, code="body.in-pieces", expected=expected, found=found, remedy=remedy)
    if not np.array_equal(fill(lattice, triangles), triangles):
        problem = "the body has an empty triangle between three of its springs"
        raise InputError(problem, code="body.empty-triangle", remedy=remedy)
