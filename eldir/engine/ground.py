"""The ground in the kernel's layout: segments, and a grid in which a search begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from eldir.core.records import FloatArray
from eldir.engine.kernels.contact import INFINITY
from eldir.engine.pack import ORIGIN, dtype, packed
from eldir.scene import Scene
from eldir.terrain import GROUND

_CELL = 0.01  # width of a cell [m]; a rugged segment is 0.02 to 0.07 m long
_MAX_CELLS = 4096


@dataclass
class PackedGround:
    level: float
    """Height at the start of the ground [m]; for flat ground, everywhere."""
    max_height: float
    """No ground is higher [m]."""
    segments: NDArray
    """x0, end, slope, intercept, level and normal of each."""
    grid_start: float
    """Start of the second cell [m]; the first and the last cell extend to infinity."""
    cells_per_m: float
    cell_segment: NDArray[np.int32]
    """A segment that begins at or before anything in the cell."""


def pack_ground(scene: Scene, grid: bool) -> PackedGround:
    """Cells overlap by half their width, so that rounding cannot put a mass outside of its own. Without the
    grid there is one cell, and masses remember nothing: they search all segments at every step."""
    return pack_segments(_segments(scene), dtype(scene), grid)


def pack_segments(rows: FloatArray, real: DTypeLike, grid: bool = True) -> PackedGround:
    """The ground of segments given as rows x0, slope, intercept, level; see `pack_ground`."""
    x0 = rows[:, 0]
    ends = np.append(x0[1:], INFINITY) if grid else np.full(len(x0), -INFINITY)
    left, right = x0[min(1, len(x0) - 1)], x0[-1]
    width = max(_CELL, (right - left) / _MAX_CELLS)
    edges = left + width * np.arange(int(np.ceil((right - left) / width)) + 1) if grid else np.zeros(0)
    lower = np.append(-INFINITY, edges - width / 2)
    first = np.maximum(np.searchsorted(x0, lower, side="right") - 1, 0)
    slope = rows[:, 1]
    normal = np.stack([-slope, np.ones(len(slope))], axis=1) / np.sqrt(1 + slope**2)[:, None]
    lines = np.column_stack([np.append(-INFINITY, x0[1:]), ends, rows[:, 1:], normal])
    return PackedGround(
        float(rows[0, 3]), _max_height(rows) if grid else INFINITY, packed(lines, real), float(left),
        1.0 / width, packed(first, np.int32),
    )  # fmt: skip


def _max_height(rows: FloatArray) -> float:
    """Ground is highest where two segments meet, unless one rises for ever."""
    x0, slope, _, level = rows.T
    if slope[0] < 0 or slope[-1] > 0:
        return INFINITY
    ends = [level[[0, -1]], slope[1:] * x0[1:] + level[1:], slope[:-1] * x0[1:] + level[:-1]]
    return float(np.concatenate(ends).max()) + 1e-6


def _segments(scene: Scene) -> FloatArray:
    """Rows x0, slope, intercept, level, from the kernel's origin; the last two differ only in the released
    code's scene.

    That code reads out of bounds left of x = 0: there it behaves as a line y = 0 to be hit and a
    floor at 0.1 m (docs/decisions/0001).
    """
    t = scene.terrain
    rows = np.stack([t.x0, t.slope, t.intercept, t.intercept], axis=1)
    if scene.contact == "friction-released":
        ahead = np.append(t.x0[1:], np.inf) > 0
        rows = np.concatenate([[[-INFINITY, 0, 0, GROUND]], rows[ahead]])
        rows[1, 0] = 0.0
    x, y = ORIGIN
    rows[:, 2:] += rows[:, 1:2] * x - y
    rows[:, 0] -= x
    return rows
