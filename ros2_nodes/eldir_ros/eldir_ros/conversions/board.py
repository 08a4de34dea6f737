# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The relay board's reports: one message with all values, and the topics that a log has of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from control_msgs.msg import DynamicJointState, InterfaceValue
from eldir_msgs.msg import BoardState as BoardStateMessage
from eldir_msgs.msg import EmergencyStop
from sensor_msgs.msg import Temperature

from eldir_hardware.log.messages import CLOSED, CURRENT, VOLTAGE
from eldir_ros.conversions import duration_of, header_of, nanoseconds, seconds_from, time_of


@dataclass(frozen=True)
class BoardState:
    """One report of the board."""

    stamp: int
    """When the board was read [ns]."""
    age: float
    """Time from that reading to the sending of the message [s]."""
    run: str
    """The run whose command was obeyed last."""
    sequence: int
    """Number of the last command that was obeyed before the reading."""
    armed: bool
    channels: tuple[str, ...]
    closed: tuple[bool, ...]
    """Whether the board reports each contact closed."""
    springs: tuple[str, ...]
    temperatures: tuple[float, ...]
    """Modelled temperature of each spring [C]."""
    peak_temperature: float
    """Highest modelled temperature so far [C]."""
    max_delay: float
    """Greatest delay of a switching so far [s]."""
    currents: tuple[float, ...] = ()
    """Measured current of each spring [A]; empty without a current sensor."""
    voltages: tuple[float, ...] = ()
    """Measured voltage across each spring [V]."""


def states_of(state: BoardState) -> BoardStateMessage:
    """The message of a report."""
    return BoardStateMessage(
        header=header_of(state.stamp),
        age=duration_of(state.age),
        run=state.run,
        sequence=state.sequence,
        armed=state.armed,
        channels=list(state.channels),
        closed=list(state.closed),
        springs=list(state.springs),
        temperatures=list(state.temperatures),
        currents=list(state.currents),
        voltages=list(state.voltages),
        peak_temperature=state.peak_temperature,
        max_delay=duration_of(state.max_delay),
    )


def state_from(message: BoardStateMessage) -> BoardState:
    """The report in a message; raises `ValueError` for one that lacks values."""
    springs, channels = tuple(message.springs), tuple(message.channels)
    if len(message.closed) != len(channels) or len(message.temperatures) != len(springs):
        raise ValueError("invalid report: expected one value for each contact and each spring")
    return BoardState(
        nanoseconds(message.header.stamp),
        seconds_from(message.age),
        message.run,
        int(message.sequence),
        bool(message.armed),
        channels,
        tuple(bool(c) for c in message.closed),
        springs,
        tuple(float(t) for t in message.temperatures),
        float(message.peak_temperature),
        seconds_from(message.max_delay),
        tuple(float(c) for c in message.currents),
        tuple(float(v) for v in message.voltages),
    )


def contacts_of(stamp: int, names: Sequence[str], closed: Sequence[bool]) -> DynamicJointState:
    """State of each relay contact, as the topic relays of a log has it; 1 is closed."""
    return _values_of(stamp, names, CLOSED, closed)


def currents_of(stamp: int, names: Sequence[str], amperes: Sequence[float]) -> DynamicJointState:
    """Current through each spring [A], as the topic currents of a log has it."""
    return _values_of(stamp, names, CURRENT, amperes)


def voltages_of(stamp: int, names: Sequence[str], volts: Sequence[float]) -> DynamicJointState:
    """Voltage across each spring [V], as the topic voltages of a log has it."""
    return _values_of(stamp, names, VOLTAGE, volts)


def _values_of(
    stamp: int, names: Sequence[str], interface: str, values: Sequence[float]
) -> DynamicJointState:
    return DynamicJointState(
        header=header_of(stamp),
        joint_names=list(names),
        interface_values=[InterfaceValue(interface_names=[interface], values=[float(v)]) for v in values],
    )


def temperature_of(stamp: int, celsius: float) -> Temperature:
    """Temperature of a spring [C]; the variance is unknown, which is 0 there."""
    return Temperature(header=header_of(stamp), temperature=celsius, variance=0.0)


def stop_of(stamp: int, reason: str | None) -> EmergencyStop:
    """State of the emergency stop: latched if there is a reason, reset if it is None."""
    return EmergencyStop(stamp=time_of(stamp), stopped=reason is not None, reason=reason or "")
