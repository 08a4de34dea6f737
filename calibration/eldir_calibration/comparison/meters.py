"""Current and voltage of the springs by a rig's current sensor, from logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir_hardware.current_sensor import CHIPS
from eldir_hardware.log.reader import RunLog
from eldir_hardware.rig.configuration import Rig

_HOT_MARGIN = 0.2
"""Part of the transition below the austenite finish: at most a tenth is still martensite there."""
_SETTLING_TIME = 0.5  # a current counts from this time after its contact closed [s]
_TIME_TOLERANCE = 1e-6  # reports and measurements with times this close belong together [s]
_UNIFORM_FACTOR = np.sqrt(3.0)  # the largest error by the standard deviation, where all within are as likely


class MeterReadings(NamedTuple):
    """Means over springs while they heat."""

    current_a: float
    """[A]."""
    voltage_v: float
    """Across a spring, without its leads [V]; half of that across two in series."""
    current_error: float
    """Largest relative error of the mean current, by the sensor's data sheet and its shunts."""
    voltage_error: float
    """Largest relative error of the voltage."""
    pulses: int
    """Pulses in which a spring was measured."""
    current_spread: float = 0.0
    """Largest relative difference of a measured spring's current from the mean. 0 where the sensor's errors
    alone may be the reason, because `current_error` has them already: half of the range is within them."""
    measured_springs: int = 1
    """Number of springs of which these are the means."""
    heated_springs: int = 1
    """Number of springs that were heated, measured or not; with `hot`, of those that got hot."""
    output_deviation: float = 0.0
    """Relative standard deviation of an output's current, by the rig file."""

    @property
    def spring_error(self) -> float:
        """Largest relative error of the mean current, taken as that of any measured spring."""
        return math.hypot(self.current_error, self.current_spread)

    @property
    def partial(self) -> str:
        """How many of the springs were measured, such as " in 3 of 4 springs"; empty if all were."""
        measured, heated = self.measured_springs, self.heated_springs
        return "" if measured == heated else f" in {measured} of {heated} springs"

    @property
    def error(self) -> float:
        """Standard deviation of current and voltage as means over the heated springs, relative. Outputs that
        were not measured may differ from the others as the rig file says, all in the same way."""
        sensor = max(self.current_error, self.voltage_error) / _UNIFORM_FACTOR
        unmeasured = 1 - self.measured_springs / self.heated_springs
        return float(math.hypot(sensor, unmeasured * self.output_deviation))


def read_meters(runs: Sequence[tuple[RunLog, Rig]], *, hot: bool) -> MeterReadings | None:
    """The mean of the springs' means over all runs, each a log and its rig; None where nothing was measured.

    `hot`: only springs that are hot by the model, from the last `_HOT_MARGIN` of their transition on, because
    the voltage depends on the phase. On a shared supply a spring counts only while it heats alone, as the
    others take from its current. A current that the sensor cannot distinguish from zero is none: the supply
    was off.
    """
    means: dict[tuple[int, str], list[tuple[float, float]]] = {}
    current_errors, voltage_errors, pulses = [], [], 0
    for log, rig in runs:
        for column, (counts, count) in _find_measurements(log, rig, hot).items():
            place = (rig.channels[column].spring, rig.channels[column].face)
            found = means.setdefault(place, [])  # empty: heated, but not measured
            if not counts.any():
                continue
            amperes, volts = (float(values[counts, column].mean()) for values in (log.currents, log.voltages))
            found.append((amperes, volts / rig.springs_per_channel))
            assert rig.sensor is not None  # it measured
            chip, sensor = CHIPS[rig.sensor.kind], rig.sensor
            error = chip.current_error(sensor.shunt_ohm, sensor.shunt_tolerance, amperes)
            current_errors.append(error / amperes)
            voltage_errors.append(chip.voltage_error(volts) / volts)
            pulses += count
    if not current_errors:
        return None
    springs = np.array([np.mean(found, axis=0) for found in means.values() if found])
    per_channel = runs[0][1].springs_per_channel
    current, voltage = np.mean(springs, axis=0)
    return MeterReadings(
        float(current),
        float(voltage),
        max(current_errors),
        max(voltage_errors),
        pulses,
        _relative_spread(springs[:, 0], max(current_errors)),
        per_channel * len(springs),
        per_channel * len(means),
        max(rig.tolerances.current for _, rig in runs) / 2,
    )


def _relative_spread(currents: FloatArray, error: float) -> float:
    """`MeterReadings.current_spread` of the springs' currents [A], with the sensor's largest relative
    error."""
    mean = currents.mean()
    if np.ptp(currents) / 2 <= error * mean:
        return 0.0
    return float(np.abs(currents / mean - 1).max())


def _find_measurements(log: RunLog, rig: Rig, hot: bool) -> dict[int, tuple[BoolArray, int]]:
    """For each heated spring: which measurements are of it while it heats, shape (L,), and in how many
    pulses. None are of a spring that the sensor does not measure."""
    if rig.sensor is None or not len(log.current_times):
        return {}
    reports = np.searchsorted(log.relay_times, log.current_times - _TIME_TOLERANCE)
    modelled = np.searchsorted(log.temperature_times, log.current_times - _TIME_TOLERANCE)
    zero_current = CHIPS[rig.sensor.kind].zero_current(rig.sensor.shunt_ohm)
    channels = [entry.channel - 1 for entry in rig.channels]
    together = log.relays[reports][:, channels].sum(axis=1)
    found = {}
    for column, channel in enumerate(channels):
        since = _closed_since(log.relay_times, log.relays[:, channel])[reports]
        counts = log.current_times - since >= _SETTLING_TIME
        if hot:
            start, finish = rig.springs.austenite_start_c, rig.springs.austenite_finish_c
            counts &= log.temperatures[modelled, column] >= finish - _HOT_MARGIN * (finish - start)
        if rig.supply.outputs == "shared":
            counts &= together == 1
        if counts.any():
            counts &= log.currents[:, column] > zero_current  # false for one that is not measured
            found[column] = (counts, len(np.unique(since[counts])))
    return found


def _closed_since(times: FloatArray, closed: BoolArray) -> FloatArray:
    """For each report: time of the first report of the pulse that it belongs to [s]; infinite where open."""
    since, begun = np.full(len(times), np.inf), np.inf
    for i, is_closed in enumerate(closed):
        begun = min(begun, times[i]) if is_closed else np.inf
        since[i] = begun
    return since
