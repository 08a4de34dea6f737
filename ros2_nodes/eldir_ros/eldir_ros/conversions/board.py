# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The relay board's reports: one message with all values, and the topics that a log has of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from eldir_hardware.rig.configuration import Rig
from eldir_ros.conversions import NewMessage, header_of, nanoseconds, time_of


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


def channel_names(rig: Rig) -> tuple[str, ...]:
    """Names of the relay channels, as in the log of a run."""
    return tuple(f"channel{i}" for i in range(1, rig.board.channels + 1))


def spring_names(rig: Rig) -> tuple[str, ...]:
    """Names of the springs, as in the log of a run."""
    return tuple(f"spring{c.spring}_{c.face}" for c in rig.channels)


def states_of(new_message: NewMessage, state: BoardState) -> Any:
    """eldir_msgs/BoardState of a report."""
    return new_message(
        "eldir_msgs/msg/BoardState",
        header=header_of(new_message, state.stamp),
        age=state.age,
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
        max_delay=state.max_delay,
    )


def state_from(message: Any) -> BoardState:
    """The report in an eldir_msgs/BoardState."""
    springs, channels = tuple(message.springs), tuple(message.channels)
    if len(message.closed) != len(channels) or len(message.temperatures) != len(springs):
        raise ValueError("invalid report: expected one value for each contact and each spring")
    return BoardState(
        nanoseconds(message.header.stamp),
        float(message.age),
        message.run,
        int(message.sequence),
        bool(message.armed),
        channels,
        tuple(bool(c) for c in message.closed),
        springs,
        tuple(float(t) for t in message.temperatures),
        float(message.peak_temperature),
        float(message.max_delay),
        tuple(float(c) for c in message.currents),
        tuple(float(v) for v in message.voltages),
    )


def values_of(new_message: NewMessage, stamp: int, names: Sequence[str], values: Sequence[float]) -> Any:
    """sensor_msgs/JointState with one number for each name, as the topics relays, currents and voltages have
    it in a log; a contact that is closed is 1."""
    positions = [float(v) for v in values]
    header = header_of(new_message, stamp)
    return new_message("sensor_msgs/msg/JointState", header=header, name=list(names), position=positions)


def temperature_of(new_message: NewMessage, stamp: int, celsius: float) -> Any:
    """sensor_msgs/Temperature; the variance is unknown, which is 0 there."""
    return new_message(
        "sensor_msgs/msg/Temperature", header=header_of(new_message, stamp), temperature=celsius, variance=0.0
    )


def stop_of(new_message: NewMessage, stamp: int, reason: str | None) -> Any:
    """eldir_msgs/EmergencyStop; latched if there is a reason, reset if it is None."""
    return new_message(
        "eldir_msgs/msg/EmergencyStop",
        stamp=time_of(new_message, stamp),
        stopped=reason is not None,
        reason=reason or "",
    )
