# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The run of a schedule: its action, the commands that heat, its edges and its ranges of motion."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from eldir.core.files import parse_json
from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_hardware.run.player import ContactEdge
from eldir_hardware.schedule import ActuationSchedule, Event
from eldir_ros.conversions import NewMessage, header_of, time_of

FINISHED, CANCELLED, PREEMPTED, STOPPED, REFUSED = range(1, 6)
"""How a run can end, as in RunSchedule.action; 0 is an empty result."""
RUNNING, RUN_FINISHED, RUN_ENDED = range(3)
"""States of a run, as in Run.msg."""
KEEPALIVE, PULSES, ABORT, END_OF_RUN = range(4)
"""Commands to the relay board, as in HeatCommand.msg."""
MAX_LEAD, MAX_DELAY = 1.0, 0.5
"""Pulses are announced at most so long before, and after, they should begin [s]."""
_MAX_BYTES = 1 << 20  # of a schedule; usual ones have some ten thousand


def schedule_from(text: str) -> ActuationSchedule:
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


def schedule_from_goal(goal: Any) -> ActuationSchedule:
    """The schedule of an eldir_msgs/RunSchedule goal, as text or as fields; raises `InputError`."""
    texts, plans = bool(goal.schedule), bool(goal.plan.events or goal.plan.period)
    if texts == plans:
        raise InputError(
            "the goal must contain one schedule",
            expected="either text (schedule) or fields (plan)",
            found="both" if texts else "neither",
        )
    return schedule_from(goal.schedule) if texts else plan_from(goal.plan)


def plan_from(message: Any) -> ActuationSchedule:
    """The schedule in an eldir_msgs/Schedule; raises `InputError` for an invalid one."""
    return ActuationSchedule(
        float(message.period),
        cycles=int(message.cycles),
        conditioning_cycles=int(message.conditioning_cycles),
        settle_s=float(message.settle),
        springs=tuple(int(s) for s in message.springs),
        events=tuple(
            Event(float(e.time), int(e.spring), e.face, int(e.channel), bool(e.closed))
            for e in message.events
        ),
    )


def plan_of(new_message: NewMessage, schedule: ActuationSchedule) -> Any:
    """eldir_msgs/Schedule."""
    return new_message(
        "eldir_msgs/msg/Schedule",
        period=schedule.period_s,
        cycles=schedule.cycles,
        conditioning_cycles=schedule.conditioning_cycles,
        settle=schedule.settle_s,
        springs=list(schedule.springs),
        events=[
            new_message(
                "eldir_msgs/msg/ScheduleEvent",
                time=e.t_s,
                spring=e.spring,
                face=e.face,
                channel=e.channel,
                closed=e.on,
            )
            for e in schedule.events
        ],
    )


def edge_of(new_message: NewMessage, edge: ContactEdge) -> Any:
    """eldir_msgs/Edge."""
    return new_message("eldir_msgs/msg/Edge", elapsed=edge.t, channel=edge.channel, closed=edge.closed)


def run_of(
    new_message: NewMessage,
    state: int,
    run_id: str,
    start: int,
    schedule: ActuationSchedule,
    message: str,
    room_c: float | None = None,
) -> Any:
    """eldir_msgs/Run; `start` is the start of the schedule [ns], `room_c` the measured air [C]."""
    return new_message(
        "eldir_msgs/msg/Run",
        state=state,
        id=run_id,
        start=time_of(new_message, start),
        schedule=json.dumps(schedule.to_json()),
        message=message,
        room_c=[] if room_c is None else [room_c],
    )


def room_of(run: Any) -> float | None:
    """The temperature of the air in an eldir_msgs/Run [C]; None if it was not measured."""
    return float(run.room_c[0]) if len(run.room_c) else None


def room_from(value: object) -> float | None:
    """The temperature of the air in a parameter [C]; None if it is not set. Raises `InputError` for anything
    but a number."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(
            "room_c is no temperature of the air",
            expected="degrees Celsius, such as 21.5",
            found=repr(value),
            remedy="ros2 param set /actuation_sequencer room_c 21.5",
        )
    return float(value)


def pulses_of(
    new_message: NewMessage, run: str, sequence: int, delay: float, lengths: Mapping[int, float]
) -> Any:
    """eldir_msgs/HeatCommand: channels that close after `delay` [s], each for its seconds in `lengths`."""
    return new_message(
        "eldir_msgs/msg/HeatCommand",
        command=PULSES,
        run=run,
        sequence=sequence,
        delay=delay,
        channels=list(lengths),
        seconds=[float(s) for s in lengths.values()],
    )


def pulses_from(message: Any) -> tuple[float, dict[int, float]]:
    """Delay [s] and duration by channel [s] of an eldir_msgs/HeatCommand; raises `ValueError` for values that
    no schedule has."""
    delay = float(message.delay)
    if not -MAX_DELAY <= delay <= MAX_LEAD:
        raise ValueError(f"its delay is {delay:g} s, expected at most {MAX_LEAD:g} s")
    lengths = {int(c): float(s) for c, s in zip(message.channels, message.seconds, strict=True)}
    if not all(0 < s < math.inf for s in lengths.values()):
        raise ValueError(f"invalid durations: expected more than 0 s, got {list(lengths.values())}")
    return delay, lengths


def ranges_of(
    new_message: NewMessage,
    stamp: int,
    cycle: int,
    names: tuple[str, ...],
    ranges: Mapping[str, FloatArray],
    displacement: float,
) -> Any:
    """eldir_msgs/RangeOfMotion of a cycle: vertical ranges of motion (K,) [m] by kind (simulated, predicted,
    tracked), and the displacement [body lengths]."""
    return new_message(
        "eldir_msgs/msg/RangeOfMotion",
        header=header_of(new_message, stamp),
        cycle=cycle,
        markers=list(names),
        displacement=displacement,
        **{kind: [float(r) for r in values] for kind, values in ranges.items()},
    )
