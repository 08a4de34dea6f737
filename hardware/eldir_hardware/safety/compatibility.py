"""Whether schedule, design, rig and packet belong together, by digests that `eldir gait` writes."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.parameters.wiring import (
    Wiring,
    is_in_series,
    select_motors,
    wiring,
    wiring_differences,
    wiring_digest,
)
from eldir_cad.packet.wiring_file import NAME, read_wiring
from eldir_hardware.rig._renamed_keys import with_original_names
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule, ScheduleDigests

if TYPE_CHECKING:
    from eldir.built.scene import PrintedScene

HEAT_SECTIONS = ("channels", "supply", "springs", "tolerances", "fan", "cutoff", "limits")
"""Sections of the rig file that affect the heat of springs."""
_DIGEST_LENGTH = 16  # hexadecimal digits of a section's digest
_REMEDY = "make it again: eldir gait DESIGN --rig RIG --out SCHEDULE"


class MismatchError(EldirError):
    """The schedule was made for another design or other rig values, or was edited."""

    code = "schedule.made-for-another"


def with_digests(
    schedule: ActuationSchedule, rig: Rig, design: Design | None = None, scene: PrintedScene | None = None
) -> ActuationSchedule:
    """The schedule with digests of its design, rig and scene, and of itself."""
    digests = ScheduleDigests(
        schedule="",
        design=None if design is None else design_digest(design),
        scene=None if scene is None else _digest(scene.to_json()),
        wiring=wiring_digest(select_motors(rig.channels, len(schedule.springs) or rig.motors)),
        rig=rig_digests(rig),
    )
    draft = replace(schedule, provenance=replace(schedule.provenance, digests=digests))
    complete = replace(digests, schedule=schedule_digest(draft))
    return replace(schedule, provenance=replace(schedule.provenance, digests=complete))


def schedule_digest(schedule: ActuationSchedule) -> str:
    """SHA-256 of a schedule file without this digest itself."""
    values = schedule.to_json()
    values["provenance"].get("digests", {}).pop("schedule", None)
    return _digest(values)


def design_digest(design: Design) -> str:
    """SHA-256 of a design without its provenance, and without the names of its parts that are not the kit's:
    a schedule does not depend on them."""
    values = Design.from_json(design.to_json()).to_json()
    return _digest({k: v for k, v in values.items() if k not in ("provenance", "other_parts")})


def rig_digests(rig: Rig) -> dict[str, str]:
    """A digest of each section of the rig file that affects heat.

    Default values are left out, and names are those of 0.1.0, so that a newer version with more entries or
    other names has the same digests.
    """
    values = rig.model_dump(mode="json", include=set(HEAT_SECTIONS), exclude_defaults=True)
    return {
        name: _digest(with_original_names(name, values.get(name)))[:_DIGEST_LENGTH] for name in HEAT_SECTIONS
    }


def require_compatible(
    schedule: ActuationSchedule, rig: Rig, design: Design | None, reason: str = ""
) -> str | None:
    """Refuse a schedule that was not made by `eldir gait` for this design and these rig values.

    `reason`: why it is played nevertheless. Returns a line for the log if it was needed, otherwise None.
    Raises `MismatchError`, and `InputError` if `springs` lacks a heated spring.
    """
    heated = max((e.spring for e in schedule.events), default=-1)
    if heated >= len(schedule.springs):
        raise InputError(
            "the schedule's springs do not name every spring that it heats",
            code="schedule.springs-missing",
            expected=f"{heated + 1} indices of the design's springs",
            found=str(list(schedule.springs)),
            remedy=_REMEDY,
        )
    differences = _differences(schedule, rig, design)
    if not differences:
        return None
    what = "; ".join(differences)
    if reason.strip():
        return f"accepted although {what}: {' '.join(reason.split())}"
    raise MismatchError(
        f"the schedule was made for something else: {what}",
        remedy=f'{_REMEDY}; or give the reason why it may be played: --accept-mismatch "REASON"',
    )


def require_same_rig(schedule: ActuationSchedule, design: Design, rig: Rig, name: str) -> None:
    """Raise `InputError` for a schedule that was made for another design or other values of the rig file
    `name`, where its walk or its heating is computed."""
    if differences := _differences(schedule, rig, design):
        raise InputError(
            f"the schedule was not made for this design and {name}: {'; '.join(differences)}",
            code="schedule.other-rig",
            remedy="name its design, and its rig file with --rig",
        )


def _differences(schedule: ActuationSchedule, rig: Rig, design: Design | None) -> list[str]:
    digests = schedule.provenance.digests
    if digests is None:
        return ["it lacks the digests of its design and rig"]
    differences = []
    if digests.schedule != schedule_digest(schedule):
        differences.append("it was edited after eldir gait")
    if design is not None and digests.design != design_digest(design):
        differences.append(
            "it lacks the digest of its design"
            if digests.design is None
            else "it was made for another design"
        )
    digests_here = rig_digests(rig)
    if others := [name for name in HEAT_SECTIONS if digests.rig.get(name) != digests_here[name]]:
        differences.append(f"the rig file has other values in {', '.join(others)}")
    return differences


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


class PacketWiring(NamedTuple):
    """The wiring of a packet."""

    connections: Wiring
    source: str
    """Where it is described, in words."""


def packet_wiring(design: Path | None, motors: int, rig: Rig) -> PacketWiring:
    """The wiring of the packet around the design file; otherwise the one that `eldir packet` writes for a rig
    like this one, with springs in series or not."""
    if design is not None and (design.parent / NAME).is_file():
        return PacketWiring(read_wiring(design.parent), str(design.parent / NAME))
    like_rig = wiring(motors, in_series=is_in_series(rig.channels))
    return PacketWiring(like_rig, "a packet that eldir writes now")


def compare_wiring(rig: Rig, packet: PacketWiring) -> str:
    """The differences of the rig's wiring from the packet's, with both digests; empty if these agree.

    Channels of the rig for motors that the packet does not have are ignored.
    """
    motors = 1 + max((c.spring for c in packet.connections), default=-1)
    connections = select_motors(rig.channels, motors)
    on_rig, in_packet = wiring_digest(connections), wiring_digest(packet.connections)
    if on_rig == in_packet:
        return ""
    differences = "; ".join(wiring_differences(connections, packet.connections))
    return f"{differences} (wiring {in_packet[:8]} in the packet, {on_rig[:8]} on the rig)"
