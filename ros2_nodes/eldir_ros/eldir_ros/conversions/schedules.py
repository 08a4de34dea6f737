# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Heating schedules as messages, with the digests of what they were made for."""

from __future__ import annotations

import hashlib
from dataclasses import replace

from eldir_msgs.msg import RigDigest, Schedule, ScheduleEvent, ScheduleOrigin

from eldir.core.files import parse_json
from eldir.errors import InputError
from eldir.parameters.wiring import HeatedFaces
from eldir_hardware.safety.compatibility import schedule_digest
from eldir_hardware.schedule import (
    ActuationSchedule,
    Event,
    ScheduleDigests,
    SchedulePrediction,
    ScheduleProvenance,
)
from eldir_ros.conversions import duration_of, nanoseconds, seconds_from

_FACES: dict[HeatedFaces, int] = {
    "front": ScheduleEvent.FRONT,
    "back": ScheduleEvent.BACK,
    "both": ScheduleEvent.BOTH,
}
_MAX_BYTES = 1 << 20  # of a schedule file; usual ones have some ten thousand


def read_schedule(text: str) -> ActuationSchedule:
    """The schedule in the text of a schedule file; raises `InputError` for an invalid one."""
    try:
        values = parse_json(text, "the schedule", _MAX_BYTES)
        if not isinstance(values, dict) or values.get("format") != ActuationSchedule.FORMAT:
            raise InputError(
                "this is not a schedule", expected=f"JSON with the format {ActuationSchedule.FORMAT}"
            )
        return ActuationSchedule.from_json(values)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(
            "the schedule is damaged",
            expected="the text of a file by `eldir gait`",
            found=f"{type(error).__name__}: {error}",
        ) from None


def schedule_of(schedule: ActuationSchedule) -> Schedule:
    """The message of a schedule; one that was edited after `eldir gait` has a plan digest that is wrong."""
    message = Schedule(
        period=duration_of(schedule.period_s),
        cycles=schedule.cycles,
        conditioning_cycles=schedule.conditioning_cycles,
        settle=duration_of(schedule.settle_s),
        springs=list(schedule.springs),
        events=[
            ScheduleEvent(
                time=duration_of(e.t_s),
                spring=e.spring,
                face=_FACES[e.face],
                channel=e.channel,
                closed=e.on,
            )
            for e in schedule.events
        ],
    )
    message.origin = _origin_of(schedule, plan_digest(message))
    return message


def schedule_from(message: Schedule) -> ActuationSchedule:
    """The schedule in a message, without predictions; raises `InputError` for an invalid one.

    Its digest of itself is right only where the message's digest of its plan is.
    """
    faces = {number: face for face, number in _FACES.items()}
    unknown = sorted({int(e.face) for e in message.events} - set(faces))
    if unknown:
        raise InputError(
            "an event of the schedule is on no face", expected="FRONT, BACK or BOTH", found=str(unknown)
        )
    schedule = ActuationSchedule(
        seconds_from(message.period),
        cycles=int(message.cycles),
        conditioning_cycles=int(message.conditioning_cycles),
        settle_s=seconds_from(message.settle),
        springs=tuple(int(s) for s in message.springs),
        events=tuple(
            Event(seconds_from(e.time), int(e.spring), faces[int(e.face)], int(e.channel), bool(e.closed))
            for e in message.events
        ),
        provenance=_provenance_from(message.origin),
    )
    digests = schedule.provenance.digests
    if digests is None or message.origin.plan_digest != plan_digest(message):
        return schedule
    digests = replace(digests, schedule=schedule_digest(schedule))
    return replace(schedule, provenance=replace(schedule.provenance, digests=digests))


def without_predictions(schedule: ActuationSchedule) -> ActuationSchedule:
    """The schedule as a message brings it."""
    return schedule_from(schedule_of(replace(schedule, predicted=SchedulePrediction())))


def plan_digest(message: Schedule) -> str:
    """SHA-256 of what a schedule switches, as ScheduleOrigin.msg defines it."""
    head = [
        nanoseconds(message.period),
        int(message.cycles),
        int(message.conditioning_cycles),
        nanoseconds(message.settle),
        *(int(s) for s in message.springs),
    ]
    rows = [
        [nanoseconds(e.time), int(e.spring), int(e.face), int(e.channel), int(e.closed)]
        for e in message.events
    ]
    text = "\n".join(" ".join(map(str, row)) for row in (head, *rows))
    return hashlib.sha256(text.encode()).hexdigest()


def _origin_of(schedule: ActuationSchedule, plan: str) -> ScheduleOrigin:
    made, digests = schedule.provenance, schedule.provenance.digests
    origin = ScheduleOrigin(
        version=made.eldir or "",
        rig=made.rig or "",
        design=made.design or "",
        seed=[] if made.seed is None else [made.seed],
    )
    if digests is None:
        return origin
    is_unedited = digests.schedule == schedule_digest(schedule)
    origin.plan_digest = plan if is_unedited else digests.schedule
    origin.design_digest = digests.design or ""
    origin.scene_digest = digests.scene or ""
    origin.wiring_digest = digests.wiring or ""
    origin.rig_digests = [RigDigest(section=s, digest=d) for s, d in digests.rig.items()]
    return origin


def _provenance_from(origin: ScheduleOrigin) -> ScheduleProvenance:
    digests = ScheduleDigests(
        schedule=origin.plan_digest,
        design=origin.design_digest or None,
        scene=origin.scene_digest or None,
        wiring=origin.wiring_digest or None,
        rig={d.section: d.digest for d in origin.rig_digests},
    )
    return ScheduleProvenance(
        eldir=origin.version or None,
        seed=int(origin.seed[0]) if len(origin.seed) else None,
        rig=origin.rig or None,
        design=origin.design or None,
        digests=digests if origin.plan_digest else None,
    )
