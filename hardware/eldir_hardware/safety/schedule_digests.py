"""For which design and rig a schedule was made: digests that `eldir gait` writes and a player compares."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.parameters.wiring import for_motors, wiring_digest
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.renamed import with_first_names
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.schedule_prediction import ScheduleDigests

if TYPE_CHECKING:
    from eldir.built.scene import BuiltScene

HEATING = ("channels", "supply", "springs", "tolerances", "fan", "cutoff", "limits")
"""Sections of the rig file that decide how hot springs get. Port, camera and virtual deviations do not."""
_SHORT = 16  # hexadecimal digits of a section's digest
_AGAIN = "make it again: eldir gait DESIGN --rig RIG --out SCHEDULE"


class MismatchError(EldirError):
    """The schedule was made for another design or other rig values, or was edited."""

    code = "schedule.made-for-another"


def with_digests(
    schedule: ActuationSchedule, rig: Rig, design: Design | None = None, scene: BuiltScene | None = None
) -> ActuationSchedule:
    """The schedule with the digests of what it was made for, and of itself."""
    digests = ScheduleDigests(
        schedule="",
        design=None if design is None else design_digest(design),
        scene=None if scene is None else _digest(scene.to_json()),
        wiring=wiring_digest(for_motors(rig.channels, len(schedule.springs) or rig.motors)),
        rig=rig_digests(rig),
    )
    open_one = replace(schedule, provenance=replace(schedule.provenance, digests=digests))
    closed = replace(digests, schedule=schedule_digest(open_one))
    return replace(schedule, provenance=replace(schedule.provenance, digests=closed))


def schedule_digest(schedule: ActuationSchedule) -> str:
    """SHA-256 of all that a schedule file contains, but for this digest itself."""
    values = schedule.to_json()
    values["provenance"].get("digests", {}).pop("schedule", None)
    return _digest(values)


def design_digest(design: Design) -> str:
    """SHA-256 of a design without its provenance, which the program ignores."""
    values = Design.from_json(design.to_json()).to_json()
    return _digest({k: v for k, v in values.items() if k != "provenance"})


def rig_digests(rig: Rig) -> dict[str, str]:
    """A digest of each section of the rig file that matters for heat.

    Values that equal their default are left out, and names are those of 0.1.0: a newer version with more
    entries, or with other names, changes nothing.
    """
    values = rig.model_dump(mode="json", include=set(HEATING), exclude_defaults=True)
    return {name: _digest(with_first_names(name, values.get(name)))[:_SHORT] for name in HEATING}


def require_made_for(
    schedule: ActuationSchedule, rig: Rig, design: Design | None, accepted: str = ""
) -> str | None:
    """Refuse a schedule that was not made by `eldir gait` for this design and these rig values.

    `accepted` is the reason why it may be played nevertheless. Returns a line for the log where it was
    needed, otherwise None. Raises `MismatchError`, and `InputError` where `springs` does not name all that
    is heated.
    """
    heated = max((e.spring for e in schedule.events), default=-1)
    if heated >= len(schedule.springs):
        raise InputError(
            "the schedule's springs do not name every spring that it heats",
            code="schedule.springs-missing",
            expected=f"{heated + 1} indices of the design's springs",
            found=str(list(schedule.springs)),
            remedy=_AGAIN,
        )
    found = _differences(schedule, rig, design)
    if not found:
        return None
    what = "; ".join(found)
    if accepted.strip():
        return f"accepted although {what}: {' '.join(accepted.split())}"
    raise MismatchError(
        f"the schedule does not belong here: {what}",
        remedy=f'{_AGAIN}; or give the reason why it may be played: --accept-mismatch "REASON"',
    )


def _differences(schedule: ActuationSchedule, rig: Rig, design: Design | None) -> list[str]:
    digests = schedule.provenance.digests
    if digests is None:
        return ["it has no digests of its design and rig"]
    found = []
    if digests.schedule != schedule_digest(schedule):
        found.append("it was edited after eldir gait")
    if design is not None and digests.design != design_digest(design):
        found.append("it has no digest of a design" if digests.design is None else "it is for another design")
    here = rig_digests(rig)
    if others := [name for name in HEATING if digests.rig.get(name) != here[name]]:
        found.append(f"the rig file has other values in {', '.join(others)}")
    return found


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
