"""Current and voltage of hot springs, from the logs of rigs with a current sensor.

They take the place of readings of an ammeter and a voltmeter in `eldir calibrate dynamics`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir_calibration.comparison.recorded_run import LoggedRun
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.sensor.chips import CHIPS

_NEARLY_HOT = 3.0  # below the austenite finish: at most a tenth is still martensite [K]
_SETTLED = 0.5  # a current counts from this time after its contact closed [s]
_SAME = 1e-6  # reports and measurements with times this close belong together [s]
_UNIFORM = np.sqrt(3.0)  # the largest error by the standard deviation, where all within are as likely


class MeterReadings(NamedTuple):
    """Means over hot springs."""

    current_a: float
    """[A]."""
    voltage_v: float
    """Across a spring, without its leads [V]."""
    error: float
    """Standard deviation of both, relative, by the sensor's data sheet and its shunts."""
    pulses: int
    """Pulses in which a spring was hot."""


def meter_readings(runs: Sequence[LoggedRun]) -> MeterReadings | None:
    """The mean of the springs' means over all runs; None where no current was measured in a hot spring.

    A spring counts as hot from `_NEARLY_HOT` below its austenite finish by the model. On a shared supply it
    counts only while it heats alone, as the others take from its current.
    """
    means: dict[tuple[int, str], list[tuple[float, float]]] = {}
    errors, pulses = [], 0
    for run in runs:
        for column, (hot, count) in _hot(run).items():
            place = (run.rig.channels[column].spring, run.rig.channels[column].face)
            amperes, volts = run.log.currents[hot, column].mean(), run.log.voltages[hot, column].mean()
            means.setdefault(place, []).append((float(amperes), float(volts)))
            errors.append(_error(run.rig, float(amperes), float(volts)))
            pulses += count
    if not means:
        return None
    current, voltage = np.mean([np.mean(found, axis=0) for found in means.values()], axis=0)
    return MeterReadings(float(current), float(voltage), max(errors), pulses)


def _hot(run: LoggedRun) -> dict[int, tuple[BoolArray, int]]:
    """For each spring: which measurements are of it while hot, shape (L,), and in how many pulses."""
    log, rig = run.log, run.rig
    if rig.sensor is None or not len(log.current_times):
        return {}
    reports = np.searchsorted(log.relay_times, log.current_times - _SAME)
    modelled = np.searchsorted(log.temperature_times, log.current_times - _SAME)
    channels = [entry.channel - 1 for entry in rig.channels]
    together = log.relays[reports][:, channels].sum(axis=1)
    found = {}
    for column, channel in enumerate(channels):
        since = _closed_since(log.relay_times, log.relays[:, channel])[reports]
        hot = log.current_times - since >= _SETTLED
        hot &= log.temperatures[modelled, column] >= rig.springs.austenite_finish_c - _NEARLY_HOT
        hot &= np.isfinite(log.currents[:, column])
        if rig.supply.outputs == "shared":
            hot &= together == 1
        if hot.any():
            found[column] = (hot, len(np.unique(since[hot])))
    return found


def _closed_since(times: FloatArray, closed: BoolArray) -> FloatArray:
    """For each report: time of the first report of the pulse that it belongs to [s]; infinite where open."""
    since, begun = np.full(len(times), np.inf), np.inf
    for i, is_closed in enumerate(closed):
        begun = min(begun, times[i]) if is_closed else np.inf
        since[i] = begun
    return since


def _error(rig: Rig, current: float, voltage: float) -> float:
    assert rig.sensor is not None  # it measured
    chip, sensor = CHIPS[rig.sensor.kind], rig.sensor
    of_current = chip.current_error(sensor.shunt_ohm, sensor.shunt_tolerance, current) / current
    return float(max(of_current, chip.voltage_error(voltage) / voltage) / _UNIFORM)
