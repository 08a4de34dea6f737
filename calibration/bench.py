"""What was read on the bench: two things that no film tells, and that a scale and an ammeter do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.individual import Individual
from calibration.recording import Body
from eldir.frozen import FloatArray

SCALES, AMMETER = 0.005, 0.005
"""Relative errors (standard deviations) of both."""


@dataclass(frozen=True)
class Bench:
    """Readings, as far as there are any."""

    weight: float | None = None
    """Of the robot's plane [kg]."""
    current: float | None = None
    """Through one hot spring, the only one that is heated; where the springs' differ, their mean [A]."""

    def off(self, body: Body, robot: Individual) -> FloatArray:
        """How far a robot is from the readings, in their standard deviations, shape (readings,)."""
        found = []
        if self.weight is not None:
            masses = robot.robot(body.morphology, body.ballast).masses
            found.append(np.log(masses.sum() / self.weight) / SCALES)
        if self.current is not None:
            found.append(np.log(robot.specimen[1].current(0.0) / self.current) / AMMETER)
        return np.array(found)


UNREAD = Bench()
"""Nobody weighed the robot or read a current."""
