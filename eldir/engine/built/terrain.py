"""A terrain under printed robots: which segment lies under a point, and the terrain in the kernel's layout.

In the frame of a segment the ground is a table, so that masses and corners meet it as they meet a table
(`integration`, `hubs`). Segments do not depend on a parameter: their numbers are plain vectors.
"""

from typing import Any, NamedTuple

import numpy as np

from eldir.engine.built.motion_launch import LANES, ZERO, LaneVector, TerrainArrays
from eldir.engine.compiler import ti
from eldir.engine.ground import pack_segments
from eldir.engine.kernels.contact import INFINITY, SEGMENT_VALUES, find_segment
from eldir.engine.pack import packed
from eldir.terrain import Terrain

_RECOVERY = 1e-3
"""Speed at which what is below the ground comes out of it [m/s]: it would be thrown out in one step."""
_MARGIN = 1e-3
"""No mass that moves farther in a step counts as far from the ground [m]."""
_STEEP = 1.7
"""Slope up to which the ground meets one of three corners of a hub."""


class SegmentLines(NamedTuple):
    """The segments under one point of each robot."""

    slope: Any
    intercept: Any
    """Height of the line at x = 0 [m]."""
    nx: Any
    """Unit vector out of the ground; the line's direction is (ny, -nx)."""
    ny: Any
    start: Any
    """Where the segment begins and ends [m]."""
    end: Any


@ti.func
def magnitude(x):
    return ti.max(x, ZERO - x)


@ti.func
def min_gap(dt):
    """Distance from the ground that counts for what is below it [m]; see `_RECOVERY`."""
    return ZERO - LaneVector(_RECOVERY) * dt


@ti.func
def any_positive(x):
    found = 0
    for j in ti.static(range(LANES)):
        if x[j] > 0.0:  # not a vector of booleans, whose elements the compilers do not find
            found = 1
    return found


@ti.func
def is_near(ground: ti.template(), x, y, travel):
    """Whether any robot's mass at (x, y), or a hub that is there with its lowest corner, may meet the ground
    while it moves by at most `travel`."""
    low = ti.select(travel > LaneVector(_MARGIN), LaneVector(-INFINITY), y - travel)
    found = 0
    for j in ti.static(range(LANES)):
        cell = ti.cast(ti.floor((x[j] - ground.grid_start) * ground.cells_per_m), ti.i32) + 1
        if low[j] < ground.cell_top[ti.max(ti.min(cell, ground.cells - 1), 0)]:
            found = 1
    return found


@ti.func
def find_lines(ground: ti.template(), x):
    slope, intercept, nx, ny = LaneVector(0.0), LaneVector(0.0), LaneVector(0.0), LaneVector(1.0)
    start, end = LaneVector(0.0), LaneVector(0.0)
    for j in ti.static(range(LANES)):
        s = SEGMENT_VALUES * find_segment(ground, x[j])
        start[j], end[j] = ground.segments[s], ground.segments[s + 1]
        slope[j], intercept[j] = ground.segments[s + 2], ground.segments[s + 3]
        nx[j], ny[j] = ground.segments[s + 5], ground.segments[s + 6]
    return ti.static(SegmentLines(slope, intercept, nx, ny, start, end))


def pack_terrain(terrain: Terrain | None, corner: float) -> TerrainArrays:
    """The terrain for hubs whose corners are at most this far from their centres [m]."""
    terrain = terrain or Terrain(np.zeros(1), np.zeros(1), np.zeros(1))
    rows = np.stack([terrain.x0, terrain.slope, terrain.intercept, terrain.intercept], axis=1)
    ground = pack_segments(rows, np.float64)
    corners = 3 if np.abs(terrain.slope).max() <= _STEEP else 5
    further = float(np.radians(60))
    first = -further * (corners // 2)
    cells = len(ground.cell_segment)
    return TerrainArrays(
        cells=cells, last_segment=len(rows) - 1, corners=corners,
        grid_start=ground.grid_start, cells_per_m=ground.cells_per_m,
        first_cosine=float(np.cos(first)), first_sine=float(np.sin(first)),
        next_cosine=float(np.cos(further)), next_sine=float(np.sin(further)),
        segments=ground.segments, cell_segment=ground.cell_segment,
        cell_top=packed(_tops(terrain, ground.grid_start, 1 / ground.cells_per_m, cells, corner), np.float64),
    )  # fmt: skip


def _tops(terrain: Terrain, start: float, width: float, cells: int, corner: float) -> Any:
    """The highest ground in each cell and around it: half a cell because of rounding, and what a mass moves
    in a step beyond its corners."""
    around = width / 2 + corner + _MARGIN
    low = start + width * np.arange(-1, cells - 1) - around
    high = low + width + 2 * around
    low[0], high[-1] = -INFINITY, INFINITY
    tops = np.maximum(terrain.height(low), terrain.height(high))
    corners = terrain.x0[1:]
    heights = terrain.height(corners)
    first, end = np.searchsorted(corners, low), np.searchsorted(corners, high, side="right")
    for cell in np.flatnonzero(first < end):
        tops[cell] = max(tops[cell], heights[first[cell] : end[cell]].max())
    return tops
