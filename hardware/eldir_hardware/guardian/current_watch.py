"""Asks the current sensor at the right moments; `measured_heat` judges. Without a sensor it does nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping

from eldir.errors import EldirError
from eldir_hardware.clock import Clock
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.measured_heat import MOVED, MeasuredHeat, describe_proof
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.sensor.driver import CurrentSensor, Measurement

_LONGEST_UNMEASURED = 0.6  # a measurement is left out for a switching no longer than this [s]


class CurrentWatch:
    """The sensor of a rig, if it has one, on the pulse controller's clock."""

    def __init__(self, rig: Rig, sensor: CurrentSensor | None, clock: Clock):
        if (sensor is None) != (rig.sensor is None):
            raise EldirError(
                "the rig file's current sensor must be opened, and no other", code="sensor.other-opened"
            )
        self._rig, self._sensor, self._clock = rig, sensor, clock
        self._heat = None if rig.sensor is None else MeasuredHeat(rig, rig.sensor)
        self._measured_at = clock.now()

    @property
    def query_time(self) -> float:
        """Duration of a measurement [s]; 0 without a sensor."""
        return 0.0 if self._sensor is None else self._sensor.query_time

    def switched(self, changes: Mapping[int, bool]) -> None:
        """Record that commands to close or open channels were just sent."""
        if self._heat is not None:
            self._heat.switched(changes, self._clock.now())

    def measure(self, before: float) -> Measurement | None:
        """Currents and voltages; None without a sensor, and where they would not be there `before` [s]."""
        now = self._clock.now()
        fits = now + self.query_time <= before
        if self._sensor is None or (not fits and now - self._measured_at < _LONGEST_UNMEASURED):
            return None
        self._measured_at = now
        return self._sensor.measure()

    def added(self, report: Report, measured: Measurement | None) -> Report:
        """The report with what was measured, in the rig file's order; NaN where nothing was."""
        if measured is None:
            return report
        in_order = [c.channel for c in self._rig.channels]
        return report._replace(
            currents=tuple(measured.currents.get(c, math.nan) for c in in_order),
            voltages=tuple(measured.voltages.get(c, math.nan) for c in in_order),
        )

    def judge(self, measured: Measurement | None) -> None:
        """Raise `CurrentFlowsError` or `WrongHeatError` where a channel is not as ordered."""
        if self._heat is not None and measured is not None:
            self._heat.judge(measured)

    def arm(self) -> None:
        """A run begins, after all contacts were opened. Raises as `prove_none`."""
        self.prove_none()
        if self._heat is not None:
            self._heat.arm()

    def prove_none(self) -> str | None:
        """What the sensor proves of channels without current in this run, after all contacts were opened.

        None without a sensor. Raises `CurrentFlowsError`, and `SensorError` where the sensor cannot tell.
        """
        if self._sensor is None or self._heat is None:
            return None
        self._clock.sleep_until(self._clock.now() + MOVED)
        self._heat.require_none(self._sensor.measure())
        return describe_proof(self._rig, self._heat.supplied)
