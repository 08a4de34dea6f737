# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The run of a schedule: its state, the commands that heat, its edges and its ranges of motion."""

from __future__ import annotations

from collections.abc import Mapping

from eldir_msgs.action import RunSchedule
from eldir_msgs.msg import Edge, HeatCommand, Pulse, RangeOfMotion, Run, Schedule

from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_hardware.run.player import ContactEdge
from eldir_hardware.schedule import ActuationSchedule
from eldir_ros.conversions import duration_of, header_of, seconds_from, time_of

FINISHED = int(RunSchedule.Result.FINISHED)
CANCELLED = int(RunSchedule.Result.CANCELLED)
PREEMPTED = int(RunSchedule.Result.PREEMPTED)
STOPPED = int(RunSchedule.Result.STOPPED)
REFUSED = int(RunSchedule.Result.REFUSED)
MAX_LEAD, MAX_DELAY = 1.0, 0.5
"""Pulses are announced at most so long before, and after, they should begin [s]."""


def edge_of(edge: ContactEdge) -> Edge:
    """The message of a contact that closed or opened."""
    return Edge(elapsed=duration_of(edge.t), channel=edge.channel, closed=edge.closed)


def phase_of(schedule: ActuationSchedule, elapsed: float) -> tuple[int, int]:
    """Phase of a run, as in the feedback of RunSchedule.action, and the cycle in it: from 1, or 0 where the
    phase has no cycles."""
    phases = RunSchedule.Feedback
    if elapsed < 0:
        return phases.ARMING, 0
    passed = elapsed - schedule.settle_s
    if passed < 0:
        return phases.SETTLING, 0
    cycle = int(passed / schedule.period_s)
    if cycle < schedule.conditioning_cycles:
        return phases.CONDITIONING, cycle + 1
    return phases.COUNTING, schedule.cycle_at(elapsed)


def run_of(
    state: int,
    run_id: str,
    start: int,
    schedule: Schedule,
    message: str,
    room_c: float | None = None,
) -> Run:
    """State of a run; `start` is the start of the schedule [ns], `room_c` the measured air [C]. The message
    of the schedule is taken as it is: between the first commands of a run there is no time to make one."""
    return Run(
        state=state,
        id=run_id,
        start=time_of(start),
        schedule=schedule,
        message=message,
        room_temperature=[] if room_c is None else [room_c],
    )


def room_of(run: Run) -> float | None:
    """The temperature of the air of a run [C]; None if it was not measured."""
    return float(run.room_temperature[0]) if len(run.room_temperature) else None


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


def pulses_of(run: str, sequence: int, delay: float, lengths: Mapping[int, float]) -> HeatCommand:
    """The command that closes channels after `delay` [s], each for its seconds in `lengths`."""
    return HeatCommand(
        command=HeatCommand.PULSES,
        run=run,
        sequence=sequence,
        delay=duration_of(delay),
        pulses=[Pulse(channel=c, duration=duration_of(s)) for c, s in lengths.items()],
    )


def pulses_from(message: HeatCommand) -> tuple[float, dict[int, float]]:
    """Delay [s] and duration by channel [s] of a command; raises `ValueError` for values that no schedule
    has."""
    delay = seconds_from(message.delay)
    if not -MAX_DELAY <= delay <= MAX_LEAD:
        raise ValueError(f"its delay is {delay:g} s, expected at most {MAX_LEAD:g} s")
    lengths = {int(p.channel): seconds_from(p.duration) for p in message.pulses}
    if len(lengths) != len(message.pulses):
        raise ValueError(f"a channel has two pulses: {[int(p.channel) for p in message.pulses]}")
    if not all(s > 0 for s in lengths.values()):
        raise ValueError(f"invalid durations: expected more than 0 s, got {list(lengths.values())}")
    return delay, lengths


def ranges_of(
    stamp: int,
    cycle: int,
    names: tuple[str, ...],
    ranges: Mapping[str, FloatArray],
    displacement: float,
) -> RangeOfMotion:
    """Vertical ranges of motion (K,) [m] in a cycle by kind (simulated, predicted, tracked), and the
    displacement [body lengths]."""
    return RangeOfMotion(
        header=header_of(stamp),
        cycle=cycle,
        markers=list(names),
        displacement=displacement,
        **{kind: [float(r) for r in values] for kind, values in ranges.items()},
    )
