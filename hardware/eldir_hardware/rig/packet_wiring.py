"""Whether a rig is wired as the packet of its design says. Another wiring is allowed, and told."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from eldir.parameters.wiring import (
    Wiring,
    for_motors,
    wiring,
    wiring_differences,
    wiring_digest,
)
from eldir_cad.packet.wiring_file import NAME, read_wiring
from eldir_hardware.rig.configuration import Rig


class PacketWiring(NamedTuple):
    """The wiring that a packet asks for."""

    connections: Wiring
    source: str
    """Where it stands, in words."""


def packet_of(design: Path | None, motors: int) -> PacketWiring:
    """The wiring of the packet that a design file lies in; otherwise the one that `eldir packet` writes."""
    if design is not None and (design.parent / NAME).is_file():
        return PacketWiring(read_wiring(design.parent), str(design.parent / NAME))
    return PacketWiring(wiring(motors), "a packet of eldir")


def wiring_note(rig: Rig, packet: PacketWiring) -> str:
    """What the rig wires differently from the packet; empty where their digests agree.

    Channels of the rig for motors that the packet does not have do not count.
    """
    motors = 1 + max((c.spring for c in packet.connections), default=-1)
    here = for_motors(rig.channels, motors)
    if wiring_digest(here) == wiring_digest(packet.connections):
        return ""
    return "; ".join(wiring_differences(here, packet.connections))
