"""Compares measured currents and voltages with the commanded contacts, and says what they prove.

Thresholds follow from the sensor's stated errors and the rig file's tolerances (docs/reference/sensor.md).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from eldir.errors import EldirError, HazardError
from eldir_hardware.clock import Clock, WallClock
from eldir_hardware.current_sensor import CHIPS, CurrentSensor, Measurement
from eldir_hardware.guardian.bank import Report
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.rig.board_identity import Port
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import open_sensor
from eldir_hardware.rig.port_holder import find_holder
from eldir_hardware.rig.sections import SensorEntry
from eldir_hardware.rig.supply import worst_springs

CONTACT_DELAY = 0.05
"""Longest time from a command until its contact has moved: wire, USB adapter (16 ms), coil, bounce [s]."""
CURRENT_SETTLING = 0.2
"""Longest time from closing a contact until the current of a limited supply has settled [s]."""
_MIN_SUPPLY_PART = 0.25  # voltages below this part of the supply's are drops along shared leads
_MAX_VOLTAGE_FACTOR = 1.1  # a supply may be set higher than the rig file says by this factor
_SENSOR_ENTRIES = {"format", "name", "kind", "board", "channels", "supply", "springs", "tolerances", "sensor"}
_SENSOR_TIMEOUT = 1.5  # how long to wait for another program that measures with the same sensor [s]
_POLL_INTERVAL = 0.005  # [s]
_MAX_UNMEASURED = 0.6  # measurements are postponed for switchings for this time at most [s]


class CurrentFlowsError(NotProvenOffError):
    """Current flows, or there is voltage, in a channel whose contact was commanded to open."""

    code = "heat.current-flows"


class UnexpectedHeatError(HazardError):
    """The measured heat is not the commanded one."""

    code = "heat.not-as-ordered"


class Bounds(NamedTuple):
    """Accepted values of a channel whose contact is closed."""

    zero_current: float
    """Currents below this count as zero [A]."""
    max_current: float
    """[A]."""
    supply_voltage_threshold: float
    """Voltages above this show that the channel is connected to the supply [V]."""
    max_voltage: float
    """[V]."""
    resistances: tuple[float, float]
    """Least and greatest resistance of the channel's springs with their clamps [Ohm]."""


class HeatBounds:
    """The bounds for the currents and voltages of a rig with its sensor."""

    def __init__(self, rig: Rig, sensor: SensorEntry):
        """Raises `LimitError` if the rig's resistance or current limit was not measured."""
        self._sensor, self._supply = sensor, rig.supply.voltage_v
        self._limit = worst_springs(rig).current_limit
        self._resistance = rig.springs_per_channel * rig.spring_parameters(fan=False).resistance

    def bounds(self, current: float) -> Bounds:
        """The bounds for a measured current [A]: the sensor's errors depend on it."""
        sensor, resistance = self._sensor, self._resistance
        chip = CHIPS[sensor.kind]
        most = self._limit + chip.current_error(sensor.shunt_ohm, sensor.shunt_tolerance, self._limit)
        current_or_zero = max(abs(current), chip.zero_current(sensor.shunt_ohm))
        error = (
            chip.current_error(sensor.shunt_ohm, sensor.shunt_tolerance, current_or_zero) / current_or_zero
        )
        error += chip.voltage_error(current_or_zero * resistance) / (current_or_zero * resistance)
        tolerance = sensor.resistance_tolerance + error
        return Bounds(
            chip.zero_current(sensor.shunt_ohm),
            most,
            _MIN_SUPPLY_PART * self._supply,
            _MAX_VOLTAGE_FACTOR * self._supply + chip.voltage_error(self._supply),
            (resistance * max(1.0 - tolerance, 0.0), resistance * (1.0 + tolerance)),
        )


def require_no_current(
    rig: Rig,
    port: Port | None = None,
    clock: Clock | None = None,
    supplied: Collection[int] | None = None,
) -> str | None:
    """Measure with the rig's sensor, or the one at `port`, whether current flows anywhere.

    Call it after all contacts were opened. `supplied`: channels in which this sensor measured the supply in
    the run that has just ended; None where there was no run. Returns in words what was proven; None if the
    rig has no sensor. Raises `CurrentFlowsError`, and `SensorError` if the sensor does not work.
    """
    clock = clock or WallClock()
    if rig.sensor is None:
        return None
    device, deadline = port or rig.sensor.port, clock.now() + _SENSOR_TIMEOUT
    while device is not None and find_holder(device) is not None and clock.now() < deadline:
        clock.sleep_until(clock.now() + _POLL_INTERVAL)
    with open_sensor(rig, clock, port) as sensor:
        if sensor is None:
            return None
        clock.sleep_until(clock.now() + CONTACT_DELAY)
        measured = sensor.measure()
        MeasuredHeat(rig, rig.sensor).require_none(measured)
    if supplied is not None:
        return describe_proof(rig, supplied)
    most = max(abs(current) for current in measured.currents.values())
    return _with_unmeasured(
        rig,
        f"the sensor shows no current in {_name_channels(measured.currents)} (at most {1e3 * most:.0f} mA), "
        "but outside a run it is unknown whether the supply is on, so this alone proves nothing",
    )


def sensor_entries(rig: Rig) -> dict[str, Any] | None:
    """The entries of the rig file that `require_no_current` needs, as a rig file without the others.

    None if no sensor outlasts the run: without one, and on a virtual rig.
    """
    if rig.sensor is None or rig.kind == "virtual":
        return None
    return rig.model_dump(mode="json", include=_SENSOR_ENTRIES)


def supplied_channels(rig: Rig, closed: Sequence[bool], currents: Mapping[int, float]) -> set[int]:
    """Channels in which a current was measured while the contact was closed: there the sensor works, and the
    supply is on. `closed`: by the board's report, channel 1 first; `currents` [A]."""
    if rig.sensor is None:
        return set()
    zero_current = CHIPS[rig.sensor.kind].zero_current(rig.sensor.shunt_ohm)
    return {
        channel
        for channel, current in currents.items()
        if closed[channel - 1] and abs(current) > zero_current
    }


def describe_proof(rig: Rig, supplied: Collection[int]) -> str:
    """What a sensor proves that shows no current anywhere, in words, for each channel that heats.

    A sensor that is dead, or on another rig, shows no current either: what it shows proves something only in
    the channels in which it has measured the supply in this run (`supplied`).
    """
    measured = set(rig.measured_channels)
    parts = []
    if proven := measured & set(supplied):
        them = "all of them" if len(proven) > 1 else "it"
        proof = f"it measured the supply in {them} in this run"
        parts.append(f"no current flows in {_name_channels(proven)} by the sensor ({proof})")
    if unproven := measured - set(supplied):
        there = " there" if proven else ""
        parts.append(
            f"the sensor shows no current in {_name_channels(unproven)}, but it has not measured the supply"
            f"{there} in this run, so this proves nothing"
        )
    return _with_unmeasured(rig, "; ".join(parts))


def _with_unmeasured(rig: Rig, text: str) -> str:
    """The text, with the channels that no sensor measures."""
    rest = {c.channel for c in rig.channels} - set(rig.measured_channels)
    return f"{text}; nothing measures {_name_channels(rest)}" if rest else text


def _name_channels(channels: Collection[int]) -> str:
    """Channels in words: channel 3; channels 1, 3; channels 1 to 4."""
    numbers = sorted(channels)
    if len(numbers) == 1:
        return f"channel {numbers[0]}"
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"channels {numbers[0]} to {numbers[-1]}"
    return f"channels {', '.join(map(str, numbers))}"


class MeasuredHeat:
    """Compares measurements with the commanded contacts. Times are on one clock [s]."""

    def __init__(self, rig: Rig, sensor: SensorEntry):
        self._bounds = HeatBounds(rig, sensor)
        self._channels = rig.measured_channels
        self._closed: set[int] = set()
        self._switched_at: dict[int, float] = {}
        self._supply_seen = False
        self.supplied: set[int] = set()
        """Channels in which current was measured since arming, while their contact was closed."""

    def arm(self) -> None:
        """Begin a run: the supply was not measured yet."""
        self._supply_seen = False
        self.supplied = set()

    def record_switching(self, changes: Mapping[int, bool], now: float) -> None:
        """Record that commands to close or open channels were just sent."""
        for channel, closed in changes.items():
            if channel not in self._channels or closed == (channel in self._closed):
                continue
            self._switched_at[channel] = now
            (self._closed.add if closed else self._closed.discard)(channel)

    def check(self, measured: Measurement) -> None:
        """Raise `CurrentFlowsError` or `UnexpectedHeatError` for the first channel that is not as commanded.

        A channel that was switched shortly before the measurement is skipped. Until the supply was measured,
        it counts as switched off, as in a rehearsal.
        """
        # Channels that must be cold first.
        in_order = sorted(self._channels, key=lambda channel: channel in self._closed)
        for channel in in_order:
            if not self._is_settled(channel, measured.started_at):
                continue
            bounds = self._bounds.bounds(measured.currents[channel])
            if channel not in self._closed:
                _require_no_heat(channel, measured, bounds)
                continue
            if abs(measured.currents[channel]) > bounds.zero_current:
                self._supply_seen = True
                self.supplied.add(channel)
            self._supply_seen |= abs(measured.voltages[channel]) > bounds.supply_voltage_threshold
            if self._supply_seen:
                _require_heat(channel, measured, bounds)

    def heating_currents(self, measured: Measurement) -> dict[int, float]:
        """The currents of the channels that heat, by channel [A]: commanded closed, settled, and with more
        than no current."""
        zero_current = self._bounds.bounds(0.0).zero_current
        return {
            channel: measured.currents[channel]
            for channel in self._channels
            if channel in self._closed
            and self._is_settled(channel, measured.started_at)
            and measured.currents[channel] > zero_current
        }

    def require_none(self, measured: Measurement) -> None:
        """Raise `CurrentFlowsError` if current flows in any channel, closed or open."""
        for channel in self._channels:
            _require_no_heat(channel, measured, self._bounds.bounds(0.0))

    def _is_settled(self, channel: int, t: float) -> bool:
        """Whether a channel was switched so long before `t` [s] that its current can be judged."""
        wait = CURRENT_SETTLING if channel in self._closed else CONTACT_DELAY
        return self._switched_at.get(channel, -float("inf")) + wait <= t


def _require_no_heat(channel: int, measured: Measurement, bounds: Bounds) -> None:
    current, voltage = measured.currents[channel], measured.voltages[channel]
    if abs(current) > bounds.zero_current:
        raise CurrentFlowsError(
            f"current flows in channel {channel} although its contact was opened",
            found=f"{current:.2f} A",
            remedy="cut the heating supply now",
        )
    if abs(voltage) > bounds.supply_voltage_threshold:
        raise CurrentFlowsError(
            f"there is voltage at channel {channel} although its contact was opened",
            found=f"{voltage:.1f} V without current, as behind a welded contact with a broken lead",
            remedy="cut the heating supply now",
        )


def _require_heat(channel: int, measured: Measurement, bounds: Bounds) -> None:
    current, voltage = measured.currents[channel], measured.voltages[channel]
    if current < -bounds.zero_current:
        raise UnexpectedHeatError(
            f"current flows backwards in channel {channel}",
            found=f"{current:.2f} A",
            remedy="swap the two leads of its shunt",
        )
    if current > bounds.max_current or channel in measured.saturated:
        raise UnexpectedHeatError(
            f"too much current flows in channel {channel}",
            expected=f"at most {bounds.max_current:.2f} A",
            found=f"{current:.2f} A{' or more' if channel in measured.saturated else ''}",
            remedy="set the supply's current limit as the rig file says",
        )
    if voltage > bounds.max_voltage or voltage < -bounds.supply_voltage_threshold:
        raise UnexpectedHeatError(
            f"implausible voltage of channel {channel}",
            expected=f"0 to {bounds.max_voltage:.1f} V",
            found=f"{voltage:.1f} V",
            remedy="check supply.voltage_v and the sensor's leads",
        )
    if current < bounds.zero_current:
        broken = voltage > bounds.supply_voltage_threshold
        raise UnexpectedHeatError(
            f"no current flows in channel {channel} although its contact was closed",
            found=f"{voltage:.1f} V",
            remedy="its spring, or a lead of it, is broken"
            if broken
            else "is the supply on? Check its fuse, the cut-off and the contact",
        )
    low, high = bounds.resistances
    if not low <= voltage / current <= high:
        raise UnexpectedHeatError(
            f"unexpected resistance of the spring of channel {channel}",
            expected=f"{low:.2f} to {high:.2f} Ohm",
            found=f"{voltage / current:.2f} Ohm",
            remedy="look for a wrong spring, a hot or loose clamp, or a short circuit",
        )


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

    def heating_currents(self, measured: Measurement | None) -> dict[int, float]:
        """The measured currents of the channels that heat, by channel [A]; empty without a sensor."""
        return {} if self._heat is None or measured is None else self._heat.heating_currents(measured)

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
