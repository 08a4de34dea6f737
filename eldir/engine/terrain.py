"""The ground as the kernel sees it: segments, and a grid that tells where to look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from eldir.engine.contact import WINDOW
from eldir.engine.pack import ORIGIN, dtype, packed
from eldir.scene import Scene
from eldir.terrain import GROUND

_CELL = 0.01  # width of a cell [m]; a rugged segment is 0.02 to 0.07 m long
_MOST_CELLS = 4096
_FAR = 1e30  # beyond any ground [m]


@dataclass
class PackedGround:
    level: float
    """Height where it begins [m]; of flat ground, everywhere."""
    segments: NDArray
    """x0, slope, intercept, level and normal of each, and one more that is never reached, flat."""
    grid_from: float
    """Where the second cell begins [m]; the first and the last cell extend for ever."""
    cells_per_m: float
    cell_segment: NDArray[np.int32]
    """A segment that begins at or before anything in the cell."""
    cell_top: NDArray
    """No ground in the cell is higher [m]."""
    cells_top: NDArray
    """Nor in this and the next cells, of which there are `WINDOW`."""


def pack_ground(scene: Scene, grid: bool) -> PackedGround:
    """Cells overlap by half their width, so that rounding cannot put a mass outside of its own."""
    rows = _segments(scene)
    if not grid:
        return _searched(rows, dtype(scene))
    x0, slope, _, level = rows.T
    left, right = x0[min(1, len(x0) - 1)], x0[-1]
    width = max(_CELL, (right - left) / _MOST_CELLS)
    inner = int(np.ceil((right - left) / width))
    edges = left + width * np.arange(-1, inner + 2)
    lower, upper = edges[:-1] - width / 2, edges[1:] + width / 2
    lower[0], upper[-1] = -_FAR, _FAR
    first = np.maximum(np.searchsorted(x0, lower, side="right") - 1, 0)
    last = np.maximum(np.searchsorted(x0, upper, side="right") - 1, 0)
    ends = np.append(x0[1:], _FAR)
    top = np.full(len(lower), -np.inf)
    for c in range(len(lower)):
        for s in range(first[c], last[c] + 1):
            at = np.array([max(x0[s], lower[c]), min(ends[s], upper[c])])
            top[c] = max(top[c], (slope[s] * at + level[s]).max())
    windows = np.array([top[c : c + WINDOW].max() for c in range(len(top))])
    real = dtype(scene)
    return PackedGround(
        float(level[0]),
        _lines(rows, real),
        float(left),
        1.0 / width,
        packed(first, np.int32),
        packed(top + 1e-6, real),
        packed(windows + 1e-6, real),
    )


def _searched(rows: NDArray[np.float64], real: DTypeLike) -> PackedGround:
    """One cell from which every segment is looked for, and above which nothing is free."""
    top = packed(np.full(1, _FAR), real)
    return PackedGround(
        float(rows[0, 3]), _lines(rows, real), 0.0, 1.0, packed(np.zeros(1), np.int32), top, top
    )


def _lines(rows: NDArray[np.float64], real: DTypeLike) -> NDArray:
    slope = rows[:, 1]
    normal = np.stack([-slope, np.ones(len(slope))], axis=1) / np.sqrt(1 + slope**2)[:, None]
    sentinel = np.array([[_FAR, 0.0, 0.0, 0.0, 0.0, 1.0]])
    return packed(np.concatenate([np.concatenate([rows, normal], axis=1), sentinel]), real)


def _segments(scene: Scene) -> NDArray[np.float64]:
    """Rows x0, slope, intercept, level, from the kernel's origin; the last two differ only in the released
    code's scene.

    That code reads out of bounds left of x = 0: there it behaves as a line y = 0 to be hit and a
    floor at 0.1 m (docs/decisions/0001).
    """
    t = scene.terrain
    rows = np.stack([t.x0, t.slope, t.intercept, t.intercept], axis=1)
    if scene.contact == "friction-released":
        ahead = np.append(t.x0[1:], np.inf) > 0
        rows = np.concatenate([[[-_FAR, 0, 0, GROUND]], rows[ahead]])
        rows[1, 0] = 0.0
    x, y = ORIGIN
    rows[:, 2:] += rows[:, 1:2] * x - y
    rows[:, 0] -= x
    return rows
