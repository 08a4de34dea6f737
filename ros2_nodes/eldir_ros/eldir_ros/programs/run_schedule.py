"""`ros2 run eldir_ros run_schedule SCHEDULE.json [NODE...]`: send a schedule and print its progress.

It waits until the relay board, the sequencer and the nodes named are active. Ctrl-C cancels the run.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions

from eldir.errors import EldirError
from eldir_ros.base.message_types import COMPLETE, message_class, new_message
from eldir_ros.conversions import runs
from eldir_ros.remote.heartbeats import Heartbeats

_PATIENCE = 60.0  # until the other nodes must be active [s]


def main() -> None:
    """Exit with status 0 only if the schedule was played to its end."""
    rclpy.init(
        args=sys.argv, signal_handler_options=SignalHandlerOptions.NO
    )  # Ctrl-C cancels the goal, below
    arguments = rclpy.utilities.remove_ros_args(sys.argv)[1:]
    if not arguments:
        sys.exit("usage: ros2 run eldir_ros run_schedule SCHEDULE.json [NODE...]")
    try:
        result = _send(Path(arguments[0]), ("relay_board", "actuation_sequencer", *arguments[1:]))
    except (OSError, EldirError) as error:
        sys.exit(f"run_schedule: {error}")
    except KeyboardInterrupt:  # before the schedule was accepted
        sys.exit(130)
    finally:
        rclpy.try_shutdown()
    hottest = f"at most {result.hottest:.1f} C"
    print(f"{result.message}; {result.duration:.1f} s, {hottest}, {len(result.edges)} edges")
    sys.exit(0 if result.outcome == runs.FINISHED else 1)


def _send(path: Path, required: tuple[str, ...]) -> Any:
    text = path.read_text()
    runs.schedule_from(text)
    node = rclpy.create_node("run_schedule")
    client = ActionClient(node, message_class("eldir_msgs/action/RunSchedule"), "run_schedule")
    _wait_for(node, required)
    if not client.wait_for_server(_PATIENCE):
        raise EldirError("no node serves the action run_schedule", remedy="start the actuation_sequencer")
    sent = client.send_goal_async(new_message("eldir_msgs/action/RunSchedule_Goal", schedule=text), _show)
    rclpy.spin_until_future_complete(node, sent)
    goal = sent.result()
    result = goal.get_result_async()
    try:
        rclpy.spin_until_future_complete(node, result)
    except KeyboardInterrupt:
        print("cancelling", file=sys.stderr)
        goal.cancel_goal_async()
        rclpy.spin_until_future_complete(node, result)
    return result.result().result


def _wait_for(node: Any, required: tuple[str, ...]) -> None:
    """Wait until these nodes are active; raises `EldirError` after a minute."""
    heartbeats, deadline = Heartbeats(), time.monotonic() + _PATIENCE
    node.create_subscription(
        message_class("diagnostic_msgs/msg/KeyValue"),
        "alive",
        lambda m: heartbeats.hear(m.key, m.value, time.monotonic()),
        COMPLETE,
    )
    while missing := heartbeats.missing(required, time.monotonic()):
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() > deadline:
            raise EldirError("; ".join(missing), remedy="ros2 lifecycle set NODE configure, then activate")


def _show(message: Any) -> None:
    f = message.feedback
    hot = ", ".join(f"{n} {t:.1f} C" for n, t in zip(f.springs, f.temperatures, strict=True))
    closed = ", ".join(str(c) for c in f.closed) or "none"
    print(f"{f.elapsed:7.2f} s  cycle {f.cycle}  closed: {closed:12s}  {hot}", flush=True)
