"""The triangular lattice on which bodies are drawn (paper, Sect. Morphology)."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir.core.records import BoolArray, FloatArray, IntArray, Record, record

HALF_SIDE = 0.025
"""Half the side of a triangle, in simulation [m]."""
MAX_SIDE = 500
"""Rows and columns at most; the paper has 13 and 22. What a lattice needs grows with their product."""
CLEARANCE = np.array([0.025, 0.1])
"""Least x and least y of a body that is placed on the ground [m]; the ground is at y = 0.1."""


@record
class Lattice(Record):
    """Triangular lattice of `rows` x `columns` triangles. The paper has 13 x 22, and 6 x 11 for building.

    Vertices lie at integer (x, y) with x + y even; one unit is `HALF_SIDE` in x and
    sqrt(3) `HALF_SIDE` in y, so that every spring is two units long.
    """

    OPTIONAL = frozenset[str]()

    rows: Annotated[int, Field(ge=1, le=MAX_SIDE)] = 13
    """Number of rows of triangles."""
    columns: Annotated[int, Field(ge=1, le=MAX_SIDE)] = 22
    """Number of columns of triangles."""

    @cached_property
    def vertices(self) -> IntArray:
        """Integer coordinates (x, y) of the vertices, sorted, shape (V, 2)."""
        even = [(x, y) for x in range(0, self.columns + 1, 2) for y in range(0, self.rows + 1, 2)]
        odd = [(x, y) for x in range(-1, self.columns + 1, 2) for y in range(1, self.rows + 1, 2)]
        return _constant(sorted(even + odd))

    @cached_property
    def triangles(self) -> IntArray:
        """Vertex indices of every triangle, ascending, shape (rows * columns, 3).

        Triangle i stands at column i mod columns of row i div columns; row 0 is the bottom.
        """
        number = {(int(x), int(y)): i for i, (x, y) in enumerate(self.vertices)}
        corners = []
        for y in range(self.rows):
            for x in range(self.columns):
                points_up = (x + y) % 2 == 1
                base, tip = (y, y + 1) if points_up else (y + 1, y)
                corners.append(sorted((number[x - 1, base], number[x + 1, base], number[x, tip])))
        return _constant(corners)

    @cached_property
    def springs(self) -> IntArray:
        """Vertex indices (a < b) of every spring, lexicographic, shape (S, 2)."""
        sides = self.triangles[:, [[0, 1], [0, 2], [1, 2]]].reshape(-1, 2)
        return _constant(np.unique(sides, axis=0))

    @cached_property
    def triangle_springs(self) -> IntArray:
        """Spring indices of the three sides of every triangle, shape (rows * columns, 3)."""
        number = {(int(a), int(b)): i for i, (a, b) in enumerate(self.springs)}
        sides = self.triangles[:, [[0, 1], [0, 2], [1, 2]]]
        return _constant([[number[int(a), int(b)] for a, b in side] for side in sides])

    @cached_property
    def spring_triangles(self) -> IntArray:
        """The one or two triangles beside every spring, shape (S, 2); the missing one is -1."""
        beside: list[list[int]] = [[] for _ in self.springs]
        for triangle, sides in enumerate(self.triangle_springs):
            for spring in sides:
                beside[spring].append(triangle)
        return _constant([[*pair, -1][:2] for pair in beside])

    def expressed_springs(self, triangles: BoolArray) -> BoolArray:
        """Whether a body has each lattice spring: from masks (..., rows, columns) to springs (..., S)."""
        flat = triangles.reshape(*triangles.shape[:-2], -1)
        nothing = np.zeros((*flat.shape[:-1], 1), bool)
        present = np.concatenate([flat, nothing], axis=-1)  # index -1 is no triangle
        one, other = self.spring_triangles.T
        return present[..., one] | present[..., other]

    def positions(self, vertices: IntArray, starts: IntArray) -> FloatArray:
        """Positions [m] of the `vertices` (indices) of several bodies, of which each starts at one of
        `starts` and is placed at `CLEARANCE`, shape (len, 2)."""
        xy = self.vertices[vertices].astype(np.float64)
        least = np.repeat(np.minimum.reduceat(xy, starts), np.diff(starts, append=len(xy)), axis=0)
        return HALF_SIDE * np.array([1.0, np.sqrt(3.0)]) * (xy - least) + CLEARANCE


def _constant(values: object) -> IntArray:
    array = np.array(values, dtype=np.int32)
    array.flags.writeable = False
    return array
