"""The relay board's reports as control_msgs interface values.

Each relay contact is a joint `channelN` with the interface `closed`, each spring a joint such as
`spring0_front` with `temperature`, and the joint `board` holds `armed`, `hottest` and `latest`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from eldir_ros.conversions import NewMessage, header_of, nanoseconds, time_of
from hardware.rig.configuration import Rig

BOARD = "board"


@dataclass(frozen=True)
class BoardState:
    """One report of the board."""

    stamp: int
    """When the board was read [ns]."""
    channels: tuple[str, ...]
    closed: tuple[bool, ...]
    """Whether the board reports each contact closed."""
    springs: tuple[str, ...]
    temperatures: tuple[float, ...]
    """Modelled temperature of each spring [C]."""
    armed: bool
    hottest: float
    """Highest modelled temperature so far [C]."""
    latest: float
    """Greatest delay of a switching so far [s]."""


def channel_names(rig: Rig) -> tuple[str, ...]:
    """Names of the relay channels, as in the log of a run."""
    return tuple(f"channel{i}" for i in range(1, rig.board.channels + 1))


def spring_names(rig: Rig) -> tuple[str, ...]:
    """Names of the springs, as in the log of a run."""
    return tuple(f"spring{c.spring}_{c.face}" for c in rig.channels)


def states_of(new_message: NewMessage, state: BoardState) -> Any:
    """control_msgs/DynamicJointState of a report."""

    def interfaces(**values: float) -> Any:
        return new_message(
            "control_msgs/msg/InterfaceValue",
            interface_names=list(values),
            values=[float(v) for v in values.values()],
        )

    return new_message(
        "control_msgs/msg/DynamicJointState",
        header=header_of(new_message, state.stamp),
        joint_names=[*state.channels, *state.springs, BOARD],
        interface_values=[
            *(interfaces(closed=c) for c in state.closed),
            *(interfaces(temperature=t) for t in state.temperatures),
            interfaces(armed=state.armed, hottest=state.hottest, latest=state.latest),
        ],
    )


def state_from(message: Any) -> BoardState:
    """The report in a control_msgs/DynamicJointState."""
    joints = {
        name: dict(zip(values.interface_names, values.values, strict=True))
        for name, values in zip(message.joint_names, message.interface_values, strict=True)
    }
    board = joints.pop(BOARD)
    contacts = {n: v["closed"] > 0.5 for n, v in joints.items() if "closed" in v}
    springs = {n: float(v["temperature"]) for n, v in joints.items() if "temperature" in v}
    return BoardState(
        nanoseconds(message.header.stamp),
        tuple(contacts),
        tuple(contacts.values()),
        tuple(springs),
        tuple(springs.values()),
        board["armed"] > 0.5,
        float(board["hottest"]),
        float(board["latest"]),
    )


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
