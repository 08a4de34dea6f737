"""Compiles a gait to a schedule for one rig: both faces alike, whole milliseconds, limits checked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from eldir.built.gait import Gait
from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir.parameters.wiring import FACES
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety import limits
from eldir_hardware.safety.schedule_digests import with_digests
from eldir_hardware.schedule import ActuationSchedule, Event
from eldir_hardware.schedule_prediction import SchedulePrediction, ScheduleProvenance

_DECIMALS = 3


class HeatingPattern(Protocol):
    """The part of a gait that becomes switching, such as an `eldir.built.gait.Gait`."""

    @property
    def period(self) -> float:
        """Period of the gait [s]."""

    @property
    def phase(self) -> FloatArray:
        """When the heating of each active spring begins, as a fraction of the period, shape (A,)."""

    @property
    def duty(self) -> FloatArray:
        """How long it lasts, as a fraction of the period, shape (A,)."""


def compile_schedule(
    gait: HeatingPattern,
    rig: Rig,
    springs: tuple[int, ...] = (),
    cycles: int = 5,
    provenance: dict[str, Any] | None = None,
) -> ActuationSchedule:
    """The schedule of a gait on this rig, with the rig's digests.

    A spring with duty 0 stays cold. `springs`: index in the design of each active spring. Raises `LimitError`
    if the schedule would exceed a limit of the rig, `InputError` if the rig has no channel for a spring.
    """
    period = round(float(gait.period), _DECIMALS)
    events = []
    for spring, (phase, duty) in enumerate(zip(gait.phase, gait.duty, strict=True)):
        on = round(float(phase) % 1.0 * period, _DECIMALS) % period
        length = round(float(duty) * period, _DECIMALS)
        if length <= 0:
            continue
        if length >= period:
            raise limits.LimitError(
                f"spring {spring} would be heated without a pause",
                expected="a duty below 1",
                found=f"{float(duty):g}",
            )
        off = round((on + length) % period, _DECIMALS) % period
        for face in FACES:
            channel = rig.channel_of(spring, face)
            if channel is None:
                raise InputError(
                    f"the rig has no channel for spring {spring} of the {face} face",
                    code="rig.no-channel",
                    expected=f"{2 * len(gait.phase)} channels",
                    found=f"{len(rig.channels)}",
                    remedy="add it to the rig file's channels",
                )
            events += [Event(on, spring, face, channel, True), Event(off, spring, face, channel, False)]
    source = ScheduleProvenance.from_json(provenance or {})
    schedule = ActuationSchedule(
        period, events=tuple(sorted(events)), cycles=cycles, springs=springs, provenance=source
    )
    prediction = limits.check_schedule(schedule, rig)
    return with_digests(
        replace(schedule, predicted=SchedulePrediction(prediction.peak_c, prediction.stuck_c)), rig
    )


def gait_of(schedule: ActuationSchedule) -> Gait | None:
    """The gait of a schedule: the inverse of `compile_schedule`, with phase 0 for a spring that stays cold.

    None if a spring is heated more than once in a period, or differently on both faces.
    """
    motors = max(len(schedule.springs), *(e.spring + 1 for e in schedule.events), 0)
    phase, duty = np.zeros(motors), np.zeros(motors)
    spring_of = {e.channel: e.spring for e in schedule.events}
    heated = {(spring_of[p.channel], p.start, p.length) for p in schedule.pulses()}
    for spring, start, length in heated:
        if duty[spring]:
            return None
        phase[spring], duty[spring] = start / schedule.period_s, length / schedule.period_s
    return Gait(schedule.period_s, phase, duty)
