"""Which relay channel heats which spring of a printed robot: one map for packet, rig file and schedule.

Each motor has two springs, on the front and on the back face of the robot. They have a channel each, or are
wired in series on one channel.
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
HeatedFaces = Literal["front", "back", "both"]


@record
class Connection(Record):
    """A spring and the relay channel that heats it; or both springs of a motor in series."""

    channel: Annotated[int, Field(ge=1)]
    """Number of the relay channel, from 1."""
    spring: Annotated[int, Field(ge=0, le=63)]
    """Number of the active spring, in the design's spring order, from 0."""
    face: HeatedFaces
    """Face of the robot on which the spring is; `both`: one channel heats the springs of both faces in
    series."""

    @property
    def spring_text(self) -> str:
        """The spring in words: "spring 1 back", or "spring 1 front and back in series"."""
        if self.face == "both":
            return f"spring {self.spring} front and back in series"
        return f"spring {self.spring} {self.face}"

    @property
    def faces(self) -> tuple[Face, ...]:
        """The faces whose springs the channel heats."""
        return FACES if self.face == "both" else (self.face,)


Wiring = tuple[Connection, ...]


def wiring(motors: int, *, in_series: bool = False) -> Wiring:
    """The wiring of a packet: motor after motor, the front face first.

    The channels of a motor do not depend on the number of motors. `in_series`: both springs of a motor in
    series on one channel.
    """
    if in_series:
        return tuple(Connection(1 + motor, motor, "both") for motor in range(motors))
    return tuple(
        Connection(1 + len(FACES) * motor + i, motor, face)
        for motor in range(motors)
        for i, face in enumerate(FACES)
    )


def is_in_series(connections: Iterable[Connection]) -> bool:
    """Whether channels heat both springs of a motor in series."""
    return any(c.face == "both" for c in connections)


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
    return "nothing" if connection is None else connection.spring_text
