"""Compression of the coils of a built robot, relative to what makes them buckle.

The simulation knows coils as straight springs. One that buckles bows sideways, carries less and touches other
parts: predictions of such a robot mean nothing. Of a hundred random designs, walkers reach less than half of
the load; bodies that their motors can hardly move reach several times the load.
"""

from __future__ import annotations

import numpy as np

from eldir.built.robot import BuiltRobot
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters


def coil_load(robot: BuiltRobot, positions: FloatArray, lengths: FloatArray) -> FloatArray:
    """Shortening of each coil over the one at which it buckles, shape (T, A); negative in tension.

    `positions` [m], shape (T, M, 2); `lengths`: free lengths at the same instants [m], shape (T, A).
    """
    a, b = robot.springs[robot.active].T
    present = np.linalg.norm(positions[:, a] - positions[:, b], axis=2)
    free = lengths[: len(present)]
    return (free - present) / SpringParameters().buckling_shortening(free)
