"""Whether a built robot stands: feet, static margin, and mechanisms that let it collapse."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.built.robot import BuiltRobot
from eldir.core.records import BoolArray, FloatArray, IntArray

_ON_GROUND = 1e-6  # height below which a mass is a foot [m]
_RANK = 1e-9  # of the largest singular value


def feet(robot: BuiltRobot) -> IntArray:
    """Indices of the masses that touch the table as assembled."""
    return np.flatnonzero(robot.positions[:, 1] < _ON_GROUND)


def static_margin(robot: BuiltRobot) -> float:
    """Horizontal distance of the centre of mass inside the feet [m]; negative: the robot falls over."""
    stands = robot.positions[feet(robot), 0]
    centre = float(robot.masses @ robot.positions[:, 0] / robot.masses.sum())
    return min(centre - float(stands.min()), float(stands.max()) - centre)


def height_over_base(robot: BuiltRobot) -> float:
    """Height of the robot divided by the distance of its outermost feet."""
    stands = robot.positions[feet(robot), 0]
    base = float(np.ptp(stands))
    return float(np.ptp(robot.positions[:, 1])) / base if base > 0 else np.inf


def triangles(springs: IntArray) -> IntArray:
    """All triples of masses that are connected with each other, ascending, shape (F, 3)."""
    count = int(springs.max()) + 1
    joined = np.zeros((count, count), bool)
    joined[springs[:, 0], springs[:, 1]] = True
    return np.array(
        [(a, b, c) for a, b in springs for c in np.flatnonzero(joined[a] & joined[b]) if c > b], np.int32
    ).reshape(-1, 3)


def least_opening(robot: BuiltRobot, positions: FloatArray) -> float:
    """The smallest area of any triangle during a motion, as a fraction of its area at rest.

    Near 0 or negative: a mass has passed through the opposite spring, which real parts cannot.
    `positions`: [m], shape (T, M, 2).
    """
    corners = triangles(robot.springs)

    def areas(x: FloatArray) -> FloatArray:
        u, v = (
            x[..., corners[:, 1], :] - x[..., corners[:, 0], :],
            x[..., corners[:, 2], :] - x[..., corners[:, 0], :],
        )
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    return float((areas(positions) / areas(robot.positions)).min())


def closest(positions: FloatArray) -> float:
    """The smallest distance between two masses during a motion [m]; `positions`: [m], shape (T, M, 2)."""
    a, b = np.triu_indices(positions.shape[1], 1)
    return float(np.sqrt((positions[:, a] - positions[:, b]) ** 2 @ np.ones(2)).min())


def shape_fault(robot: BuiltRobot) -> str:
    """Why the body does not keep its shape, or why its motors cannot change it; empty if neither is the
    case."""
    pinned = robot.parameters.bending == 0  # clamped strips hold a body that would fold on pins
    if pinned and (loose := freedoms(robot.positions, robot.springs)):
        return f"{loose} free mechanisms with all springs in place"
    if not freedoms(robot.positions, robot.springs[~robot.active]):
        return "rigid without its motors: they hardly move it"
    return ""


def held_motors(positions: FloatArray, springs: IntArray, active: BoolArray) -> IntArray:
    """Indices of the active springs whose two masses the strips hold in their places to each other, whatever
    the other motors do."""
    strips = springs[~active]
    free = freedoms(positions, strips)
    held = [s for s in np.flatnonzero(active) if freedoms(positions, [*strips, springs[s]]) == free]
    return np.array(held, np.int32)


def freedoms(positions: FloatArray, springs: IntArray | Sequence[IntArray]) -> int:
    """Number of independent mechanisms: motions, beside the three rigid ones, that change no spring's length.

    2 M - 3 - rank of the rigidity matrix, for masses in general position: small random displacements remove
    the special angles of the lattice, so that only mechanisms of the graph count.
    """
    shaken = positions + 0.1 * 0.05 * np.random.default_rng(0).uniform(-1, 1, positions.shape)
    a, b = np.asarray(springs, np.int32).reshape(-1, 2).T  # none, where all springs are motors
    matrix = np.zeros((len(a), len(positions), 2))
    rows = np.arange(len(a))
    matrix[rows, a], matrix[rows, b] = shaken[a] - shaken[b], shaken[b] - shaken[a]
    sizes = np.linalg.svd(matrix.reshape(len(a), 2 * len(positions)), compute_uv=False)
    return 2 * len(positions) - 3 - int((sizes > _RANK * sizes.max(initial=0.0)).sum())
