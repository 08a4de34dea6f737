"""A body on a grid of cells, on which springs are constant shifts: nothing is gathered or scattered.

A vertex at lattice coordinates (x, y) has neighbours at (x + 2, y), (x - 1, y + 1) and (x + 1, y + 1). With
the cell (x - y) / 2 + (k + 1) y these are 1, k and k + 1 cells further on, for any k. The least k that gives
every mass a cell of its own packs the body densest: three masses in four cells for the paper's bodies.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.core.records import IntArray
from eldir.errors import InputError
from eldir.morphology import Bodies, offsets

FAMILIES = 3
_REACHES = 8  # tried at a time


class Grid(NamedTuple):
    """A body's cells."""

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


def place_on_grids(bodies: Bodies) -> list[Grid]:
    """The densest grid of each body. Raises `InputError` for springs that do not join neighbours of a
    lattice."""
    x, y = _coordinates(bodies)
    u = (x - y) // 2
    a, b = bodies.springs.T
    du, dy = u[b] - u[a], y[b] - y[a]
    downward = dy < 0
    du, dy = np.where(downward, -du, du), np.abs(dy)
    family = np.select([(du == 1) & (dy == 0), (du == -1) & (dy == 1), (du == 0) & (dy == 1)], [0, 1, 2], -1)
    if (family < 0).any():
        s = int(np.flatnonzero(family < 0)[0])
        one, other = bodies["vertices"][bodies.springs[s]]
        raise InputError(
            "a spring does not join neighbours of the lattice",
            code="body.no-lattice",
            expected="Morphology.vertices of one lattice, and springs between them",
            found=f"spring {s - bodies.spring_at[bodies.of_spring[s]]} between vertices {one} and {other}",
            remedy="create bodies with eldir.morphology.develop",
        )
    reach = _min_reach(bodies, u, y)
    cell = u + (reach[bodies.of_mass] + 1) * y
    cell = (cell - bodies.least(cell)).astype(np.int32)
    first = np.where(downward, cell[b], cell[a]).astype(np.int32)
    family, counts = family.astype(np.int32), np.maximum.reduceat(cell, bodies.mass_at[:-1]) + 2
    ends = (pairwise(at.tolist()) for at in (bodies.mass_at, bodies.spring_at))
    return [
        Grid(k, n, cell[i:j], family[s:t], first[s:t])
        for k, n, (i, j), (s, t) in zip(reach.tolist(), counts.tolist(), *ends, strict=True)
    ]


def _min_reach(bodies: Bodies, u: IntArray, y: IntArray) -> IntArray:
    """The least reach of each body that gives every mass a cell of its own."""
    u, y, sizes = u - bodies.least(u), y - bodies.least(y), np.diff(bodies.mass_at)
    width, height = (np.maximum.reduceat(c, bodies.mass_at[:-1]) for c in (u, y))
    reach = np.maximum((sizes - 1 - width) // np.maximum(height, 1) - 1, 1)  # with fewer cells than masses
    some, left = np.arange(_REACHES)[:, None], np.arange(len(bodies))
    while len(left):  # a large reach always fits: then no row of vertices meets another
        n = sizes[left]
        room = offsets(width[left] + (reach[left] + _REACHES) * height[left] + 1)
        cells = np.repeat(room[:-1], n) + u + (np.repeat(reach[left], n) + 1 + some) * y
        taken = np.zeros(_REACHES * room[-1], bool)
        taken[cells + some * room[-1]] = True
        fits = np.add.reduceat(taken.reshape(_REACHES, -1), room[:-1], axis=1, dtype=np.int32) == n
        found = fits.any(axis=0)
        reach[left] += np.where(found, fits.argmax(axis=0), _REACHES)
        remain = np.repeat(~found, n)
        left, u, y = left[~found], u[remain], y[remain]
    return reach


def _coordinates(bodies: Bodies) -> tuple[IntArray, IntArray]:
    """Lattice coordinates of the masses, wherever they are in space.

    Vertices are numbered by (x, y) from x = -1 on, where y is odd. The ends of a level spring, two columns
    apart, therefore differ by the number of vertices in two columns, and those of no spring by more.
    """
    vertices = bodies["vertices"].astype(np.int64)
    a, b = bodies.springs.T
    period = np.ones(len(bodies), np.int64)
    np.maximum.at(period, bodies.of_spring, np.abs(vertices[b] - vertices[a]))
    period = period[bodies.of_mass]
    columns, rest = np.divmod(vertices, period)
    odd = period // 2
    upper = rest >= odd
    return 2 * columns - 1 + upper, np.where(upper, 2 * (rest - odd), 2 * rest + 1)
