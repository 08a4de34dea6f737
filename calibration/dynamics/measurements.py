"""What was read on the bench: three things that no film tells, and that scales and two meters do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.dynamics.recording import Body
from eldir.built.robot import build
from eldir.core.records import FloatArray
from eldir.parameters.robot import RobotParameters

SCALES, METER = 0.005, 0.005
"""Relative errors (standard deviations) of a weight, and of a current or voltage."""


@dataclass(frozen=True)
class Bench:
    """Readings, as far as there are any."""

    weight: float | None = None
    """Of the robot's plane [kg]."""
    current: float | None = None
    """Through one hot spring, the only one that is heated; where the springs' differ, their mean [A]."""
    voltage: float | None = None
    """Across that spring, without its leads [V]."""

    def off(self, body: Body, robot: RobotParameters) -> FloatArray:
        """How far a robot is from the readings, in their standard deviations, shape (readings,)."""
        found = []
        if self.weight is not None:
            masses = build(body.morphology, robot, ballast=body.ballast).masses
            found.append(np.log(masses.sum() / self.weight) / SCALES)
        hot = robot.springs
        if self.current is not None:
            found.append(np.log(hot.current(0.0) / self.current) / METER)
        if self.voltage is not None:
            found.append(np.log(hot.current(0.0) * hot.resistance_at(0.0) / self.voltage) / METER)
        return np.array(found)


UNREAD = Bench()
"""Nobody weighed the robot or read a current."""
