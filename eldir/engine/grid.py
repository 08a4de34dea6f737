"""A body on a grid of cells, on which springs are constant shifts: nothing is gathered or scattered.

A vertex at lattice coordinates (x, y) has neighbours at (x + 2, y), (x - 1, y + 1) and (x + 1, y + 1). With
the cell (x - y) / 2 + (k + 1) y these are 1, k and k + 1 cells further on, for any k. The least k that gives
every mass a cell of its own packs the body densest: three masses in four cells for the paper's bodies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.errors import InputError
from eldir.morphology import Morphology

FAMILIES = 3


class Grid(NamedTuple):
    reach: int
    """k: the other end of a spring of family 0, 1 or 2 is 1, k or k + 1 cells further on."""
    cell_count: int
    """Cells up to the last mass, and one that is always empty."""
    cell: NDArray[np.int32]
    """Cell of every mass, shape (M,)."""
    family: NDArray[np.int32]
    """Family of every spring, shape (S,)."""
    first: NDArray[np.int32]
    """Cell of the near end of every spring, shape (S,)."""


def place_on_grid(body: Morphology) -> Grid:
    """The densest grid; refuses springs that do not join neighbours of a lattice."""
    x, y = _coordinates(body)
    u = (x - y) // 2
    a, b = body.springs.T
    du, dy = u[b] - u[a], y[b] - y[a]
    downward = dy < 0
    du, dy = np.where(downward, -du, du), np.abs(dy)
    family = np.select([(du == 1) & (dy == 0), (du == -1) & (dy == 1), (du == 0) & (dy == 1)], [0, 1, 2], -1)
    if (family < 0).any():
        s = int(np.flatnonzero(family < 0)[0])
        raise InputError(
            "a spring does not join neighbours of the lattice",
            code="body.no-lattice",
            expected="Morphology.vertices of one lattice, and springs between them",
            found=f"spring {s} between vertices {body.vertices[a[s]]} and {body.vertices[b[s]]}",
            remedy="create bodies with eldir.morphology.develop",
        )
    reach = np.arange(1, np.ptp(u) + 2)
    cells = u + (reach[:, None] + 1) * y
    ordered = np.sort(cells, axis=1)
    distinct = (np.diff(ordered, axis=1) > 0).all(axis=1)
    k = int(np.argmax(distinct))  # the last always is: then no row of vertices meets another
    cell = (cells[k] - ordered[k, 0]).astype(np.int32)
    first = np.where(downward, cell[b], cell[a]).astype(np.int32)
    return Grid(int(reach[k]), int(cell.max()) + 2, cell, family.astype(np.int32), first)


def _coordinates(body: Morphology) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Lattice coordinates of the masses, wherever they are in space.

    Vertices are numbered by (x, y) from x = -1 on, where y is odd. The ends of a level spring, two columns
    apart, therefore differ by the number of vertices in two columns, and those of no spring by more.
    """
    vertices = body.vertices.astype(np.int64)
    a, b = body.springs.T
    period = int(np.abs(vertices[b] - vertices[a]).max(initial=1))
    columns, rest = np.divmod(vertices, period)
    odd = period // 2
    upper = rest >= odd
    return 2 * columns - 1 + upper, np.where(upper, 2 * (rest - odd), 2 * rest + 1)
