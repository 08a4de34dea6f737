"""Readings of scales, an ammeter and a voltmeter: three quantities that no film determines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.built.robot import build
from eldir.core.records import FloatArray
from eldir.parameters.robot import RobotParameters
from eldir_calibration.dynamics.recording import FilmedBody
from eldir_calibration.dynamics.settings import DEFAULT_SETTINGS, IdentificationSettings


@dataclass(frozen=True)
class Measurements:
    """Readings; None for a quantity that was not measured."""

    weight: float | None = None
    """Mass of one plane of the robot [kg]."""
    current: float | None = None
    """Current through one hot spring while no other is heated [A]; if springs differ, their mean."""
    voltage: float | None = None
    """Voltage across that spring, without its leads [V]."""
    error: float | None = None
    """Standard deviation of current and voltage, relative; None: that of a good meter."""

    def residuals(
        self,
        body: FilmedBody,
        robot: RobotParameters,
        settings: IdentificationSettings = DEFAULT_SETTINGS,
    ) -> FloatArray:
        """How far a robot is from the readings, in their standard deviations, shape (readings,)."""
        found = []
        error = settings.meter_error if self.error is None else self.error
        if self.weight is not None:
            masses = build(body.morphology, robot, ballast=body.ballast).masses
            found.append(np.log(masses.sum() / self.weight) / settings.weight_error)
        hot = robot.springs
        if self.current is not None:
            found.append(np.log(hot.current(0.0) / self.current) / error)
        if self.voltage is not None:
            across = hot.current(0.0) * hot.resistance_at(0.0)
            found.append(np.log(across / self.voltage) / error)
        return np.array(found)


NOT_MEASURED = Measurements()
"""No measurements: nobody weighed the robot or read a meter."""
