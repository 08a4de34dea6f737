"""The run of a schedule: its action, its edges as reported, its ranges of motion."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_ros.conversions import NewMessage, header_of, nanoseconds, time_of
from hardware.schedule import FORMAT, ActuationSchedule

FINISHED, CANCELLED, PREEMPTED, STOPPED, REFUSED = range(5)
"""How a run can end, as in RunSchedule.action."""
RUNNING, RUN_FINISHED, RUN_ENDED = range(3)
"""States of a run, as in Run.msg."""


@dataclass
class Edges:
    """Contacts that closed and opened, from one report to the next."""

    found: list[tuple[float, int, bool]] = field(default_factory=list)
    """Seconds since the start, channel, whether it closed."""
    _last: tuple[bool, ...] = ()

    def see(self, elapsed: float, closed: tuple[bool, ...]) -> None:
        """A report of all contacts; all are open before the first."""
        before = self._last or (False,) * len(closed)
        for channel, (was, now) in enumerate(zip(before, closed, strict=True), start=1):
            if was != now:
                self.found.append((elapsed, channel, now))
        self._last = tuple(closed)


def schedule_from(text: str) -> ActuationSchedule:
    """Of the text of a schedule file; what is wrong with it is named."""
    try:
        values = json.loads(text)
        if not isinstance(values, dict) or values.get("format") != FORMAT:
            raise InputError("this is not a schedule", expected=f"JSON with the format {FORMAT}")
        return ActuationSchedule.from_json(values)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "the schedule is damaged",
            expected="the text of a file by `eldir gait`",
            found=f"{type(error).__name__}: {error}",
        ) from None


def cycle_at(schedule: ActuationSchedule, elapsed: float) -> int:
    """The cycle that counts, from 1; 0 before the first; the last after the end."""
    passed = elapsed - schedule.start_of_cycles
    return 0 if passed < 0 else min(int(passed / schedule.period_s) + 1, schedule.cycles)


def edge_of(new_message: NewMessage, edge: tuple[float, int, bool]) -> Any:
    """eldir_msgs/Edge."""
    elapsed, channel, closed = edge
    return new_message("eldir_msgs/msg/Edge", elapsed=elapsed, channel=channel, closed=closed)


def run_of(
    new_message: NewMessage, state: int, run_id: str, start: int, schedule: str, message: str = ""
) -> Any:
    """eldir_msgs/Run; `start` of the schedule [ns]."""
    return new_message(
        "eldir_msgs/msg/Run",
        state=state,
        id=run_id,
        start=time_of(new_message, start),
        schedule=schedule,
        message=message,
    )


def pulses_of(new_message: NewMessage, run: str, at: int, lengths: dict[int, float]) -> Any:
    """eldir_msgs/HeatCommand: channels that close at `at` [ns] for so many seconds."""
    return new_message(
        "eldir_msgs/msg/HeatCommand",
        command=1,
        run=run,
        at=time_of(new_message, at),
        channels=list(lengths),
        seconds=[float(s) for s in lengths.values()],
    )


def pulses_from(message: Any) -> tuple[int, dict[int, float]]:
    """The inverse of `pulses_of`."""
    lengths = zip(message.channels, message.seconds, strict=True)
    return nanoseconds(message.at), {int(c): float(s) for c, s in lengths}


def ranges_of(
    new_message: NewMessage,
    stamp: int,
    names: tuple[str, ...],
    ranges: dict[str, FloatArray],
    walked: dict[str, float],
) -> Any:
    """control_msgs/DynamicJointState of vertical ranges of motion [m].

    Each mark is a joint with the interfaces of `ranges`, such as simulated, predicted and tracked, each
    (K,); the joint `body` tells how far it walked in the cycle [body lengths].
    """

    def interfaces(values: dict[str, float]) -> Any:
        numbers = [float(v) for v in values.values()]
        return new_message("control_msgs/msg/InterfaceValue", interface_names=list(values), values=numbers)

    rows = [interfaces({kind: r[k] for kind, r in ranges.items()}) for k in range(len(names))]
    return new_message(
        "control_msgs/msg/DynamicJointState",
        header=header_of(new_message, stamp),
        joint_names=[*names, "body"],
        interface_values=[*rows, interfaces(walked)],
    )
