"""Development: from a genotype to masses and springs (paper, Sect. Morphology)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.arguments import require_shape
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.errors import InputError
from eldir.genotype import Genotype, component_count, fill
from eldir.lattice import HALF_SIDE, Lattice


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
    def key(self) -> bytes:
        """Equal for bodies of the same masses, springs and motors, wherever on the lattice they grew."""
        return self.positions.tobytes() + self.springs.tobytes() + self.active.tobytes()


def develop(lattice: Lattice, genotype: Genotype) -> Morphology:
    """The body of a repaired genotype, placed at least x = 0.025 m and least y = 0.1 m.

    Raises `InputError` for an empty, unfilled or disconnected body.
    """
    body = _checked_body(lattice, genotype)
    expressed = np.flatnonzero(lattice.expressed_springs(body))
    ends = lattice.springs[expressed]
    vertices, numbered = np.unique(ends, return_inverse=True)
    return Morphology(
        positions=lattice.positions(vertices),
        springs=numbered.reshape(-1, 2),
        rest_lengths=np.full(len(expressed), 2 * HALF_SIDE),
        active=genotype.springs[expressed],
        vertices=vertices,
        lattice_springs=expressed,
    )


def _checked_body(lattice: Lattice, genotype: Genotype) -> BoolArray:
    body = genotype.triangles
    require_shape("triangles", body.shape, (lattice.rows, lattice.columns))
    require_shape("springs", genotype.springs.shape, (len(lattice.springs),))
    parts, remedy = int(component_count(body[None])[0]), "repair it with eldir.genotype.repair_bodies"
    if parts != 1:
        problem, expected = "the body is not in one piece", "1 connected component"
        raise InputError(problem, code="body.in-pieces", expected=expected, found=str(parts), remedy=remedy)
    if not np.array_equal(fill(lattice, body[None])[0], body):
        problem = "the body has an empty triangle between three of its springs"
        raise InputError(problem, code="body.empty-triangle", remedy=remedy)
    return body
