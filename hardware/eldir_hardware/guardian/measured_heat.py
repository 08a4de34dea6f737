"""What measured currents and voltages say about contacts, leads and springs. Decides; reads nothing itself.

Thresholds follow from the sensor's stated errors and the rig file's tolerances (docs/reference/sensor.md).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from eldir.errors import HazardError
from eldir_hardware.clock import Clock, WallClock
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.rig.board_identity import Port
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import SensorEntry
from eldir_hardware.rig.sensors import open_sensor
from eldir_hardware.rig.supply import worst_springs
from eldir_hardware.sensor.chips import CHIPS
from eldir_hardware.sensor.driver import Measurement

MOVED = 0.05
"""A contact has moved this long after its command: wire, USB adapter (16 ms), coil, bounce [s]."""
STEADY = 0.2
"""The current of a limited supply has settled this long after a contact closed [s]."""
_PART_OF_SUPPLY = 0.25  # voltages below this part of the supply's are drops along shared leads
_MOST_VOLTAGE = 1.1  # a supply may be set higher than the rig file says by this factor


class CurrentFlowsError(NotProvenOffError):
    """Current flows, or voltage stands, in a channel whose contact was commanded to open."""

    code = "heat.current-flows"


class WrongHeatError(HazardError):
    """The measured heat is not the one that was ordered."""

    code = "heat.not-as-ordered"


class Bounds(NamedTuple):
    """What is accepted of a channel whose contact is closed."""

    zero: float
    """Currents below this are none [A]."""
    most_current: float
    """[A]."""
    standing: float
    """A voltage above this shows that the channel is connected to the supply [V]."""
    most_voltage: float
    """[V]."""
    resistances: tuple[float, float]
    """Least and greatest resistance of a spring with its clamps [Ohm]."""


class AcceptedHeat:
    """What a rig and its sensor accept. A guardian judges every channel five times a second."""

    def __init__(self, rig: Rig, sensor: SensorEntry):
        """Raises `LimitError` where resistance or current limit of the rig were not measured."""
        self._sensor, self._supply = sensor, rig.supply.voltage_v
        self._limit = worst_springs(rig).current_limit
        self._resistance = rig.spring_parameters(fan=False).resistance

    def bounds(self, current: float) -> Bounds:
        """The bounds for a measured current [A]: the sensor's errors depend on it."""
        sensor, resistance = self._sensor, self._resistance
        chip = CHIPS[sensor.kind]
        most = self._limit + chip.current_error(sensor.shunt_ohm, sensor.shunt_tolerance, self._limit)
        flowing = max(abs(current), chip.zero(sensor.shunt_ohm))
        error = chip.current_error(sensor.shunt_ohm, sensor.shunt_tolerance, flowing) / flowing
        error += chip.voltage_error(flowing * resistance) / (flowing * resistance)
        deviation = sensor.resistance_tolerance + error
        return Bounds(
            chip.zero(sensor.shunt_ohm),
            most,
            _PART_OF_SUPPLY * self._supply,
            _MOST_VOLTAGE * self._supply + chip.voltage_error(self._supply),
            (resistance * max(1.0 - deviation, 0.0), resistance * (1.0 + deviation)),
        )


def require_no_current(
    rig: Rig,
    port: Port | None = None,
    clock: Clock | None = None,
    supplied: Collection[int] | None = None,
) -> str | None:
    """Ask the rig's sensor, at another port or the very one of a run, whether current flows anywhere.

    Call it when all contacts were opened. `supplied`: channels in which this sensor measured the supply in
    the run that has just ended; None where there was no run. Returns in words what was proven, or None where
    the rig has no sensor. Raises `CurrentFlowsError`, and `SensorError` where the sensor cannot tell.
    """
    clock = clock or WallClock()
    with open_sensor(rig, clock, port) as sensor:
        if sensor is None or rig.sensor is None:
            return None
        clock.sleep_until(clock.now() + MOVED)
        measured = sensor.measure()
        MeasuredHeat(rig, rig.sensor).require_none(measured)
    if supplied is not None:
        return describe_proof(rig, supplied)
    most = max(abs(current) for current in measured.currents.values())
    return _and_unmeasured(
        rig,
        f"the sensor shows no current in {_named(measured.currents)} (at most {1e3 * most:.0f} mA), but "
        "outside a run it is not known whether it sees the supply, so this alone proves nothing",
    )


def supplied_channels(rig: Rig, closed: Sequence[bool], currents: Mapping[int, float]) -> set[int]:
    """Channels in which a current was measured while the contact was closed: there the sensor works, and the
    supply is on. `closed`: by the board's report, channel 1 first; `currents` [A]."""
    if rig.sensor is None:
        return set()
    zero = CHIPS[rig.sensor.kind].zero(rig.sensor.shunt_ohm)
    return {channel for channel, current in currents.items() if closed[channel - 1] and abs(current) > zero}


def describe_proof(rig: Rig, supplied: Collection[int]) -> str:
    """What a sensor proves that shows no current anywhere, in words, for each channel that heats.

    A sensor that is dead, or on another rig, shows no current either: what it shows proves something only in
    the channels in which it has measured the supply in this run (`supplied`).
    """
    measured = set(rig.measured_channels)
    parts = []
    if proven := measured & set(supplied):
        them = "all of them" if len(proven) > 1 else "it"
        seen = f"it measured the supply in {them} in this run"
        parts.append(f"no current flows in {_named(proven)} by the sensor ({seen})")
    if blind := measured - set(supplied):
        there = " there" if proven else ""
        parts.append(
            f"the sensor shows no current in {_named(blind)}, but it has not seen the supply{there} in this "
            "run, so this proves nothing"
        )
    return _and_unmeasured(rig, "; ".join(parts))


def _and_unmeasured(rig: Rig, text: str) -> str:
    """The text, and the channels of which no sensor tells anything."""
    rest = {c.channel for c in rig.channels} - set(rig.measured_channels)
    return f"{text}; nothing measures {_named(rest)}" if rest else text


def _named(channels: Collection[int]) -> str:
    """Channels in words: channel 3; channels 1, 3; channels 1 to 4."""
    numbers = sorted(channels)
    if len(numbers) == 1:
        return f"channel {numbers[0]}"
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"channels {numbers[0]} to {numbers[-1]}"
    return f"channels {', '.join(map(str, numbers))}"


class MeasuredHeat:
    """Compares measurements with the contacts that were ordered. Times are on one clock [s]."""

    def __init__(self, rig: Rig, sensor: SensorEntry):
        self._accepted = AcceptedHeat(rig, sensor)
        self._channels = rig.measured_channels
        self._closed: set[int] = set()
        self._switched: dict[int, float] = {}
        self._supplied = False
        self.supplied: set[int] = set()
        """Channels in which current was measured since arming, while their contact was closed."""

    def arm(self) -> None:
        """A run begins: nothing was seen yet of the supply."""
        self._supplied = False
        self.supplied = set()

    def switched(self, changes: Mapping[int, bool], now: float) -> None:
        """Record that commands to close or open channels were just sent."""
        for channel, closed in changes.items():
            if channel not in self._channels or closed == (channel in self._closed):
                continue
            self._switched[channel] = now
            (self._closed.add if closed else self._closed.discard)(channel)

    def judge(self, measured: Measurement) -> None:
        """Raise `CurrentFlowsError` or `WrongHeatError` for the first channel that is not as ordered.

        A channel that was switched too shortly before the measurement began is not judged by it. As long as
        the supply was never seen, it counts as switched off: schedules are rehearsed like that.
        """
        in_order = sorted(self._channels, key=lambda channel: channel in self._closed)  # the danger first
        for channel in in_order:
            if self._switched.get(channel, -float("inf")) + self._wait(channel) > measured.began:
                continue
            bounds = self._accepted.bounds(measured.currents[channel])
            if channel not in self._closed:
                _require_no_heat(channel, measured, bounds)
                continue
            if abs(measured.currents[channel]) > bounds.zero:
                self._supplied = True
                self.supplied.add(channel)
            self._supplied |= abs(measured.voltages[channel]) > bounds.standing
            if self._supplied:
                _require_ordered_heat(channel, measured, bounds)

    def require_none(self, measured: Measurement) -> None:
        """Raise `CurrentFlowsError` where any current flows, whatever was ordered."""
        for channel in self._channels:
            _require_no_heat(channel, measured, self._accepted.bounds(0.0))

    def _wait(self, channel: int) -> float:
        return STEADY if channel in self._closed else MOVED


def _require_no_heat(channel: int, measured: Measurement, bounds: Bounds) -> None:
    current, voltage = measured.currents[channel], measured.voltages[channel]
    if abs(current) > bounds.zero:
        raise CurrentFlowsError(
            f"current flows in channel {channel} although its contact was opened",
            found=f"{current:.2f} A",
            remedy="cut the heating supply now",
        )
    if abs(voltage) > bounds.standing:
        raise CurrentFlowsError(
            f"voltage stands at channel {channel} although its contact was opened",
            found=f"{voltage:.1f} V without current, as behind a welded contact with a broken lead",
            remedy="cut the heating supply now",
        )


def _require_ordered_heat(channel: int, measured: Measurement, bounds: Bounds) -> None:
    current, voltage = measured.currents[channel], measured.voltages[channel]
    if current < -bounds.zero:
        raise WrongHeatError(
            f"current flows backwards in channel {channel}",
            found=f"{current:.2f} A",
            remedy="swap the two leads of its shunt",
        )
    if current > bounds.most_current or channel in measured.saturated:
        raise WrongHeatError(
            f"too much current flows in channel {channel}",
            expected=f"at most {bounds.most_current:.2f} A",
            found=f"{current:.2f} A{' or more' if channel in measured.saturated else ''}",
            remedy="set the supply's current limit as the rig file says",
        )
    if voltage > bounds.most_voltage or voltage < -bounds.standing:
        raise WrongHeatError(
            f"the voltage of channel {channel} cannot be right",
            expected=f"0 to {bounds.most_voltage:.1f} V",
            found=f"{voltage:.1f} V",
            remedy="check supply.voltage_v and the sensor's leads",
        )
    if current < bounds.zero:
        broken = voltage > bounds.standing
        raise WrongHeatError(
            f"no current flows in channel {channel} although its contact was closed",
            found=f"{voltage:.1f} V",
            remedy="its spring, or a lead of it, is broken"
            if broken
            else "is the supply on? Check its fuse, the cut-off and the contact",
        )
    low, high = bounds.resistances
    if not low <= voltage / current <= high:
        raise WrongHeatError(
            f"the spring of channel {channel} has a wrong resistance",
            expected=f"{low:.2f} to {high:.2f} Ohm",
            found=f"{voltage / current:.2f} Ohm",
            remedy="look for a wrong spring, a hot or loose clamp, or a short circuit",
        )
