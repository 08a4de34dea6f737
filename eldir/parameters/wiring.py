"""Which relay channel heats which spring of a printed robot: one map for packet, rig file and schedule.

Each motor has two springs, on the front and on the back face of the robot.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field

from eldir.core.records import Record, record

Face = Literal["front", "back"]
FACES: tuple[Face, Face] = ("front", "back")


@record
class Connection(Record):
    """A spring and the relay channel that heats it."""

    channel: Annotated[int, Field(ge=1)]
    """Number of the relay channel, from 1."""
    spring: Annotated[int, Field(ge=0, le=63)]
    """Number of the active spring, in the design's spring order, from 0."""
    face: Face
    """Face of the robot on which the spring is."""


Wiring = tuple[Connection, ...]


def wiring(motors: int) -> Wiring:
    """The wiring of a packet: motor after motor, the front face first.

    The channels of a motor do not depend on the number of motors.
    """
    return tuple(
        Connection(1 + len(FACES) * motor + i, motor, face)
        for motor in range(motors)
        for i, face in enumerate(FACES)
    )


def select_motors(connections: Iterable[Connection], motors: int) -> Wiring:
    """The connections of the first motors, by channel; a rig may have channels for more."""
    return tuple(sorted(c for c in connections if c.spring < motors))


def wiring_digest(connections: Iterable[Connection]) -> str:
    """SHA-256 of a wiring, independent of its order, hexadecimal."""
    rows = [[c.channel, c.spring, c.face] for c in sorted(connections)]
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()


def wiring_differences(rig: Iterable[Connection], packet: Iterable[Connection]) -> list[str]:
    """A sentence for each channel that heats one spring in the packet and another one on the rig."""
    on_rig, in_packet = ({c.channel: c for c in connections} for connections in (rig, packet))
    return [
        f"channel {n} heats {_text(in_packet.get(n))} in the packet, {_text(on_rig.get(n))} on the rig"
        for n in sorted({*on_rig, *in_packet})
        if on_rig.get(n) != in_packet.get(n)
    ]


def _text(connection: Connection | None) -> str:
    """Such as "spring 1 back"."""
    return "nothing" if connection is None else f"spring {connection.spring} {connection.face}"
