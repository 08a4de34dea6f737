"""Printed robots on a terrain: which terrains the simulation knows, and where a robot begins.

A terrain is in metres of the printed robot (`eldir.terrain.Terrain.scaled`). As on the table, heights count
from where the centre of a mass is that stands: a hub's corner is one corner's distance below it.
"""

from __future__ import annotations

import numpy as np

from eldir.built.robot import PrintedRobot, build, rest_state
from eldir.core.arguments import require_value
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.terrain import Terrain

MAX_SLOPE = 20.0
"""Steepest segment: 87 degrees."""
MIN_SEGMENT = 1e-4
"""Shortest segment [m], so that a mass does not cross two of them in one step."""

PLATE_THICKNESS = 0.012
"""Thickness of a printed ground where it is lowest [m]."""
_BEHIND, _AHEAD = 0.5, 2.5  # of printed ground, behind and ahead of the robot [body lengths]


def check_terrain(terrain: Terrain) -> None:
    """Raise `InputError` for segments that are too steep or too short."""
    steepest, shortest = np.abs(terrain.slope).max(), np.diff(terrain.x0).min(initial=np.inf)
    expected = f"slopes up to {MAX_SLOPE:g}"
    require_value(
        "terrain", steepest <= MAX_SLOPE, expected, f"{steepest:g}", "slant vertical walls a little"
    )
    expected = f"segments of at least {MIN_SEGMENT * 1e3:g} mm"
    require_value("terrain", shortest >= MIN_SEGMENT * (1 - 1e-9), expected, f"{shortest * 1e3:g} mm")
    jump = np.abs(_steps(terrain)).max(initial=0.0)
    require_value("terrain", jump < 1e-9, "segments that meet", f"a jump of {jump * 1e3:g} mm")


def surface_line(terrain: Terrain, positions: FloatArray, corner: float) -> FloatArray:
    """Corners of the surface of the printed ground under a robot with masses at `positions` [m], shape
    (M, 2): x and height [m], shape (K, 2). It is `corner` below the centre of a mass that stands [m]."""
    return terrain.outline(*printed_range(positions)) - np.array([0.0, corner])


def _steps(terrain: Terrain) -> FloatArray:
    """Difference of height where two segments meet [m]."""
    lines = terrain.slope * np.append(terrain.x0[1:], 0.0) + terrain.intercept
    return np.asarray(lines[:-1] - terrain.height(terrain.x0[1:]))


def place(robot: PrintedRobot, terrain: Terrain | None) -> FloatArray:
    """State at rest as assembled (`rest_state`), lifted or lowered until the robot touches the terrain; it is
    not rotated."""
    state = rest_state(robot)
    if terrain is not None:
        state[1] += find_lift(robot.positions, robot.parameters.corner, terrain)
    return state


def begin_on(robot: PrintedRobot, terrain: Terrain | None, margin: float) -> tuple[FloatArray, FloatArray]:
    """For pictures: where the masses begin (`place`), shape (M, 2), and the corners of the surface from
    `margin` behind the robot to `margin` ahead of it, shape (K, 2) [m]; a table is at 0."""
    begin = place(robot, terrain)[:2].T
    first, last = begin[:, 0].min() - margin, begin[:, 0].max() + margin
    table = np.array([[first, 0.0], [last, 0.0]])
    return begin, table if terrain is None else terrain.outline(first, last)


def find_lift(positions: FloatArray, corner: float, terrain: Terrain) -> float:
    """Height by which masses at these positions (M, 2) are lifted until one touches the terrain [m]; hubs
    have corners at a distance `corner` from their centres, one of which points down."""
    if corner > 0:
        angles = np.radians(60) * np.arange(6)
        arms = corner * np.stack([np.sin(angles), 1 - np.cos(angles)], axis=1)
        positions = (positions[:, None] + arms).reshape(-1, 2)
    return float((terrain.height(positions[:, 0]) - positions[:, 1]).max())


def heights(positions: FloatArray, terrain: Terrain | None) -> FloatArray:
    """Height of each mass over the ground under it [m], shape (T, M); `positions`: [m], shape (T, M, 2)."""
    over = positions[..., 1]
    return over if terrain is None else over - terrain.height(positions[..., 0])


def printed_range(positions: FloatArray) -> tuple[float, float]:
    """From where to where the ground under a robot is printed [m]; `positions`: its masses as assembled [m],
    shape (M, 2)."""
    left, right = float(positions[:, 0].min()), float(positions[:, 0].max())
    length = right - left
    return left - _BEHIND * length, right + _AHEAD * length


def on_table(terrain: Terrain, positions: FloatArray) -> Terrain:
    """The terrain at the height at which its printed ground lies on the table y = 0: where it is lowest, it
    is `PLATE_THICKNESS` high."""
    lift = PLATE_THICKNESS - float(surface_line(terrain, positions, 0.0)[:, 1].min())
    return Terrain(terrain.x0.copy(), terrain.slope.copy(), terrain.intercept + lift)


def lay_on_table(design: Design) -> Terrain | None:
    """The terrain of a design, `on_table`; None: a table."""
    if design.printed_terrain is None:
        return None
    return on_table(design.printed_terrain, build(design.morphology).positions)
