# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""`ros2 run eldir_ros run_schedule SCHEDULE.json [NODE...]`: send a schedule and print its progress.

It waits until the relay board, the sequencer and the nodes named are active. Its heartbeats keep the run
alive: whatever ends this program, or the one that started it, ends the heat. Ctrl-C cancels the run.
"""

from __future__ import annotations

import os
import signal
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from eldir_msgs.action import RunSchedule
from eldir_msgs.msg import EmergencyStop, Heartbeat
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from eldir.errors import EldirError
from eldir_hardware.realtime import COMMANDS, request_realtime_priority
from eldir_ros.base.qualities import COMPLETE, LATCHED
from eldir_ros.base.spinning import ros_errors_as_eldir_errors
from eldir_ros.conversions import runs, seconds_from, time_of
from eldir_ros.conversions.schedules import read_schedule, schedule_of
from eldir_ros.remote.heartbeats import PERIOD, Heartbeats

_ACTIVE_TIMEOUT = 60.0  # until the other nodes must be active [s]
_RESULT_TIMEOUT = 15.0  # from a cancellation to the result [s]
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
_PHASES = {
    RunSchedule.Feedback.ARMING: "arming",
    RunSchedule.Feedback.SETTLING: "settling",
    RunSchedule.Feedback.CONDITIONING: "conditioning",
}
_INTERRUPTED = 130  # exit status of a program that Ctrl-C ended


def main() -> None:
    """Exit with status 0 only if the schedule was played to its end."""
    arguments = rclpy.utilities.remove_ros_args(sys.argv)[1:]
    if not arguments:
        sys.exit("usage: ros2 run eldir_ros run_schedule SCHEDULE.json [NODE...]")
    request_realtime_priority(COMMANDS)  # without its heartbeats the run is stopped
    try:
        with ros_errors_as_eldir_errors():
            rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        result = _send(Path(arguments[0]), ("relay_board", "actuation_sequencer", *arguments[1:]))
    except (OSError, EldirError) as error:
        sys.exit(f"run_schedule: {error}")
    except _EndedError as ended:
        print(f"run_schedule: {ended}; nothing was heated", file=sys.stderr)
        sys.exit(_INTERRUPTED)
    finally:
        rclpy.try_shutdown()
    temperature = f"at most {result.peak_temperature:.1f} C"
    duration = seconds_from(result.duration)
    print(f"{result.message}; {duration:.1f} s, {temperature}, {len(result.edges)} edges", flush=True)
    sys.exit(0 if result.outcome == runs.FINISHED else 1)


class _EndedError(Exception):
    """A signal has ended the program, or its parent process has ended."""


class _EndCondition:
    """Watches for signals, and for the end of the parent process: `ros2 run`, `ros2 launch`."""

    def __init__(self) -> None:
        self._parent = os.getppid()
        self._signal = ""
        for number in _SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:  # with nohup a closed terminal is no reason
                signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, _frame: object) -> None:
        self._signal = self._signal or f"ended by {signal.Signals(number).name}"

    @property
    def reason(self) -> str:
        """Why this program has to end; empty while it has not."""
        parent_ended = "" if os.getppid() == self._parent else "the parent process has ended"
        return self._signal or parent_ended


class _Client:
    """Receives the states of the nodes and of the emergency stop, and sends the goal's heartbeats."""

    def __init__(self) -> None:
        self.name = f"run_schedule_{uuid.uuid4().hex[:8]}"
        self.node = rclpy.create_node("run_schedule")
        self.action = ActionClient(self.node, RunSchedule, "run_schedule")
        self.heartbeats, self.stopped = Heartbeats(), ""
        self.node.create_subscription(Heartbeat, "alive", self._on_heartbeat, COMPLETE)
        self.node.create_subscription(EmergencyStop, "emergency_stop", self._on_stop, LATCHED)
        self._alive = self.node.create_publisher(Heartbeat, "run_schedule/alive", COMPLETE)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # whatever /clock does
        self.node.create_timer(PERIOD, self._send_heartbeat, clock=steady)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def close(self) -> None:
        self._executor.shutdown()
        self.action.destroy()
        self.node.destroy_node()

    @property
    def is_connected(self) -> bool:
        """Whether a sequencer serves the action and subscribes to the heartbeats."""
        return self.action.server_is_ready() and self._alive.get_subscription_count() > 0

    def spin_until(self, done: Callable[[], bool], check: Callable[[], None]) -> None:
        """Handle messages until `done`; `check` may raise."""
        while not done():
            check()
            self._executor.spin_once(timeout_sec=0.1)

    def _send_heartbeat(self) -> None:
        now = int(self.node.get_clock().now().nanoseconds)
        self._alive.publish(Heartbeat(stamp=time_of(now), name=self.name))

    def _on_heartbeat(self, message: Heartbeat) -> None:
        self.heartbeats.update(message.name, message.state.label, time.monotonic())

    def _on_stop(self, message: EmergencyStop) -> None:
        self.stopped = message.reason if message.stopped else ""


def _send(path: Path, required: tuple[str, ...]) -> RunSchedule.Result:
    schedule = read_schedule(path.read_text())
    end = _EndCondition()
    with ros_errors_as_eldir_errors():
        client = _Client()
    try:
        _wait_for(client, end, required)
        goal = RunSchedule.Goal(schedule=schedule_of(schedule), client=client.name)
        sent = client.action.send_goal_async(goal, _print_feedback)
        client.spin_until(sent.done, lambda: _require_sequencer(client))
        accepted = sent.result()
        if not accepted.accepted:
            raise EldirError("the sequencer already has two schedules", remedy="wait until they have ended")
        return _await_result(client, end, accepted)
    finally:
        client.close()


def _await_result(client: _Client, end: _EndCondition, goal: ClientGoalHandle) -> RunSchedule.Result:
    """The result of a goal; a signal cancels it."""
    result = goal.get_result_async()
    client.spin_until(lambda: result.done() or bool(end.reason), lambda: _require_sequencer(client))
    if not result.done():
        print(f"cancelling: {end.reason}", file=sys.stderr, flush=True)
        goal.cancel_goal_async()
        deadline = time.monotonic() + _RESULT_TIMEOUT

        def check() -> None:
            _require_sequencer(client)
            if time.monotonic() > deadline:
                raise EldirError("the sequencer sent no result of the run", remedy="look at the rig")

        client.spin_until(result.done, check)
    return result.result().result


def _require_sequencer(client: _Client) -> None:
    """Raise `EldirError` if the sequencer does not play the schedule any more."""
    state = client.heartbeats.state_of("actuation_sequencer", time.monotonic())
    if state in ("absent", "silent"):
        raise EldirError(
            f"actuation_sequencer is {state}",
            expected="the result of the run",
            remedy="without its commands relay_board has switched everything off; look at the rig",
        )


def _wait_for(client: _Client, end: _EndCondition, required: tuple[str, ...]) -> None:
    """Wait until these nodes are active; raises `EldirError` after a minute, or while a stop is latched."""
    deadline, is_reported = time.monotonic() + _ACTIVE_TIMEOUT, False

    def missing() -> tuple[str, ...]:
        return client.heartbeats.missing(required, time.monotonic())

    def check() -> None:
        nonlocal is_reported
        if end.reason:
            raise _EndedError(end.reason)
        if client.stopped:
            raise EldirError(
                f"the emergency stop is latched: {client.stopped}",
                remedy="look at the rig, then: ros2 service call /reset_emergency_stop std_srvs/srv/Trigger",
            )
        left = deadline - time.monotonic()
        if left < 0:
            raise EldirError(
                "; ".join(missing()) or "no node serves the action run_schedule",
                remedy="ros2 lifecycle set NODE configure, then activate",
            )
        if not is_reported and left < _ACTIVE_TIMEOUT - 5.0:
            is_reported = True
            print(f"waiting: {'; '.join(missing()) or 'for the action'}", file=sys.stderr, flush=True)

    client.spin_until(lambda: not missing() and client.is_connected and not client.stopped, check)


def _print_feedback(message: Any) -> None:
    f: RunSchedule.Feedback = message.feedback
    part = f"cycle {f.cycle}" if f.phase == f.COUNTING else _PHASES.get(f.phase, "")
    hot = ", ".join(f"{n} {t:.1f} C" for n, t in zip(f.springs, f.temperatures, strict=True))
    closed = ", ".join(str(c) for c in f.closed) or "none"
    print(f"{seconds_from(f.elapsed):7.2f} s  {part:12s}  closed: {closed:12s}  {hot}", flush=True)
