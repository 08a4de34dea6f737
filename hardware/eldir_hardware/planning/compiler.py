"""Compiles a gait to a schedule for one rig, checks its limits, and says how exactly the board plays it."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from eldir.built.gait import Gait
from eldir.core.records import FloatArray
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_driver
from eldir_hardware.safety import limits
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import ActuationSchedule, Event, SchedulePrediction, ScheduleProvenance

_DECIMALS = 3
MAX_HEAT_ERROR = 0.02
"""Allowed relative error of the heat of a pulse."""
MAX_TIME_ERROR = 0.020
"""Allowed error of the instant at which a contact switches [s]."""
_PROGRAM_DELAY = 0.005  # of this computer between a pulse's two edges, at the 99th percentile [s]


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
                f"the duty of spring {spring} is too large",
                expected="a duty below 1",
                found=f"{float(duty):g}",
            )
        off = round((on + length) % period, _DECIMALS) % period
        for wired in rig.connections_of(spring):
            events += [
                Event(time, spring, wired.face, wired.channel, closes)
                for time, closes in ((on, True), (off, False))
            ]
    source = ScheduleProvenance.from_json(provenance or {})
    schedule = ActuationSchedule(
        period, events=tuple(sorted(events)), cycles=cycles, springs=springs, provenance=source
    )
    prediction = limits.check_schedule(schedule, rig)
    return with_digests(
        replace(schedule, predicted=SchedulePrediction(prediction.peak_c, prediction.stuck_c)), rig
    )


def extract_gait(schedule: ActuationSchedule) -> Gait | None:
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


def describe_precision(schedule: ActuationSchedule, rig: Rig) -> str:
    """A sentence if the board exceeds `MAX_HEAT_ERROR` or `MAX_TIME_ERROR`; otherwise empty."""
    if not schedule.events:
        return ""
    board = get_driver(rig.board.kind)
    at_once = Counter(e.t_s for e in schedule.events if e.on)
    # The mean of contacts that close one after another is on time; they open at once.
    half_spread = (max(at_once.values()) - 1) / 2 * board.closing_interval
    length = min(p.length for p in schedule.pulses())
    off = (_PROGRAM_DELAY + half_spread) / length
    sentences = []
    if off > MAX_HEAT_ERROR:
        needed = (_PROGRAM_DELAY + half_spread) / MAX_HEAT_ERROR
        sentences.append(
            f"the heat of pulses of {length:g} s is exact to {100 * off:.0f} % only; "
            f"{100 * MAX_HEAT_ERROR:g} % need pulses of {needed:.2g} s"
        )
    if half_spread > MAX_TIME_ERROR:
        sentences.append(
            f"contacts close up to {1e3 * half_spread:.0f} ms before or after their time, because "
            f"{max(at_once.values())} are due at once"
        )
    return f"on a board of kind {rig.board.kind}, " + "; ".join(sentences) if sentences else ""
