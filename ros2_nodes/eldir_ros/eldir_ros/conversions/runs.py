"""The run of a schedule: its action, the commands that heat, its edges and its ranges of motion."""

from __future__ import annotations

from typing import Any

from eldir.core.json_text import parse_json
from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_ros.conversions import NewMessage, header_of, nanoseconds, time_of
from hardware.run.contact_edges import ContactEdge
from hardware.schedule import FORMAT, ActuationSchedule

FINISHED, CANCELLED, PREEMPTED, STOPPED, REFUSED = range(1, 6)
"""How a run can end, as in RunSchedule.action; 0 is an empty result."""
RUNNING, RUN_FINISHED, RUN_ENDED = range(3)
"""States of a run, as in Run.msg."""
_LARGEST = 1 << 20  # text of a schedule [bytes]; those of this program have some ten thousand


def schedule_from(text: str) -> ActuationSchedule:
    """The schedule in the text of a schedule file; raises `InputError` that says what is wrong."""
    try:
        values = parse_json(text, "the schedule", _LARGEST)
        if not isinstance(values, dict) or values.get("format") != FORMAT:
            raise InputError("this is not a schedule", expected=f"JSON with the format {FORMAT}")
        return ActuationSchedule.from_json(values)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(
            "the schedule is damaged",
            expected="the text of a file by `eldir gait`",
            found=f"{type(error).__name__}: {error}",
        ) from None


def edge_of(new_message: NewMessage, edge: ContactEdge) -> Any:
    """eldir_msgs/Edge."""
    return new_message("eldir_msgs/msg/Edge", elapsed=edge.t, channel=edge.channel, closed=edge.closed)


def run_of(
    new_message: NewMessage, state: int, run_id: str, start: int, schedule: str, message: str = ""
) -> Any:
    """eldir_msgs/Run; `start` is the start of the schedule [ns]."""
    return new_message(
        "eldir_msgs/msg/Run",
        state=state,
        id=run_id,
        start=time_of(new_message, start),
        schedule=schedule,
        message=message,
    )


def pulses_of(new_message: NewMessage, run: str, at: int, lengths: dict[int, float]) -> Any:
    """eldir_msgs/HeatCommand: channels that close at `at` [ns], each for its seconds in `lengths`."""
    return new_message(
        "eldir_msgs/msg/HeatCommand",
        command=1,
        run=run,
        at=time_of(new_message, at),
        channels=list(lengths),
        seconds=[float(s) for s in lengths.values()],
    )


def pulses_from(message: Any) -> tuple[int, dict[int, float]]:
    """Instant [ns] and channel to seconds of a eldir_msgs/HeatCommand."""
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
    (K,); the joint `body` has the displacement in the cycle [body lengths].
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
