"""Compression of the coils of a built robot, relative to what makes them buckle.

The simulation knows coils as straight springs. One that buckles bows sideways, carries less and touches other
parts: predictions of such a robot mean nothing. Of a hundred random designs, walkers reach less than half of
the load; bodies that their motors can hardly move reach several times the load.
"""

from __future__ import annotations

import numpy as np

from eldir.built.motion import BuiltMotion
from eldir.built.robot import BuiltRobot
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters


def coil_load(robot: BuiltRobot, motion: BuiltMotion, lengths: FloatArray) -> FloatArray:
    """Shortening of each coil over the one at which it buckles, shape (T, A); negative in tension.

    Coils are measured between their hinges. `lengths`: free lengths at the instants of the motion [m], shape
    (T, A).
    """
    a, b = robot.springs[robot.active].T
    between, free = motion.positions[:, a] - motion.positions[:, b], lengths[: len(motion.positions)]
    if robot.joints == "hubs":
        x, y = robot.directions[robot.active].T
        for hubs in (a, b):
            c, s = np.moveaxis(motion.rotations[:, hubs], 2, 0)
            between = between - robot.parameters.socket * np.stack([c * x - s * y, s * x + c * y], axis=2)
    present = np.linalg.norm(between, axis=2) + 2 * robot.parameters.socket
    return (free - present) / SpringParameters().buckling_shortening(free)
