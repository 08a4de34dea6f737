"""Measures with the current sensor between switchings, if the rig has one, and checks the measured heat."""

from __future__ import annotations

import math
from collections.abc import Mapping

from eldir.errors import EldirError
from eldir_hardware.clock import Clock
from eldir_hardware.current_sensor import CurrentSensor, Measurement
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.measured_heat import CONTACT_DELAY, MeasuredHeat, describe_proof
from eldir_hardware.rig.configuration import Rig

_MAX_UNMEASURED = 0.6  # measurements are postponed for switchings for this time at most [s]


class CurrentWatch:
    """The sensor of a rig, if it has one, on the pulse controller's clock."""

    def __init__(self, rig: Rig, sensor: CurrentSensor | None, clock: Clock):
        if (sensor is None) != (rig.sensor is None):
            raise EldirError(
                "the opened current sensor is not that of the rig file", code="sensor.other-opened"
            )
        self._rig, self._sensor, self._clock = rig, sensor, clock
        self._heat = None if rig.sensor is None else MeasuredHeat(rig, rig.sensor)
        self._measured_at = clock.now()

    @property
    def query_time(self) -> float:
        """Duration of a measurement [s]; 0 without a sensor."""
        return 0.0 if self._sensor is None else self._sensor.query_time

    def record_switching(self, changes: Mapping[int, bool]) -> None:
        """Record that commands to close or open channels were just sent."""
        if self._heat is not None:
            self._heat.record_switching(changes, self._clock.now())

    def measure(self, before: float) -> Measurement | None:
        """Currents and voltages; None without a sensor, or if that takes longer than until `before`."""
        now = self._clock.now()
        fits = now + self.query_time <= before
        if self._sensor is None or (not fits and now - self._measured_at < _MAX_UNMEASURED):
            return None
        self._measured_at = now
        return self._sensor.measure()

    def add_to(self, report: Report, measured: Measurement | None) -> Report:
        """The report with the measured values, in the rig file's order; NaN for channels without an input."""
        if measured is None:
            return report
        in_order = [c.channel for c in self._rig.channels]
        return report._replace(
            currents=tuple(measured.currents.get(c, math.nan) for c in in_order),
            voltages=tuple(measured.voltages.get(c, math.nan) for c in in_order),
        )

    def check(self, measured: Measurement | None) -> None:
        """Raise `CurrentFlowsError` or `UnexpectedHeatError` if a channel is not as commanded."""
        if self._heat is not None and measured is not None:
            self._heat.check(measured)

    def arm(self) -> None:
        """A run begins, after all contacts were opened. Raises as `prove_no_current`."""
        self.prove_no_current()
        if self._heat is not None:
            self._heat.arm()

    def prove_no_current(self) -> str | None:
        """Prove that no current flows, after all contacts were opened, and return the proof in words.

        None without a sensor. Raises `CurrentFlowsError`, and `SensorError` if the sensor does not work.
        """
        if self._sensor is None or self._heat is None:
            return None
        self._clock.sleep_until(self._clock.now() + CONTACT_DELAY)
        self._heat.require_none(self._sensor.measure())
        return describe_proof(self._rig, self._heat.supplied)
