# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The actuation sequencer: plays a schedule as an action; cancelled or preempted, everything is off."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Mapping
from typing import Any

from eldir_msgs.action import RunSchedule
from eldir_msgs.msg import BoardState, Heartbeat, HeatCommand, Run
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup

from eldir_hardware.realtime import COMMANDS, request_realtime_priority
from eldir_hardware.rig.configuration import Rig
from eldir_ros.base.parameters import get_file, get_number, get_optional_value, get_text, get_texts
from eldir_ros.base.qualities import COMPLETE, LATCHED
from eldir_ros.base.rig_node import ACTIVE, RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import board, duration_of, runs, time_of
from eldir_ros.conversions.schedules import schedule_from
from eldir_ros.remote.heartbeats import CLIENT_TIMEOUT, Heartbeats
from eldir_ros.remote.remote_bank import RemoteBank
from eldir_ros.remote.schedule_run import RunProgress, RunRequest, RunScheduleResult, ScheduleRun

_MAX_GOALS = 2  # one that runs, and one that preempts it


class ActuationSequencerNode(RigNode):
    """Serves the action `run_schedule`, one goal at a time; a new goal preempts the running one.

    The client of a goal sends heartbeats as long as the run lasts. Without them everything is off.
    """

    def __init__(self, **options: Any):
        super().__init__("actuation_sequencer", **options)
        self._rig: Rig | None = None
        self._goals: dict[bytes, _GoalLink] = {}
        """Goals that were accepted and have not ended."""
        self._early_cancels: set[bytes] = set()
        """Accepted goals whose cancellation came before `_start_goal`: rclpy answers the client first."""
        self._playing_lock, self._goals_lock = threading.Lock(), threading.Lock()
        self._client_heartbeats = Heartbeats(CLIENT_TIMEOUT)
        self.commands = self.advertise(HeatCommand, "relay_board/commands", COMPLETE)
        self.run_states = self.advertise(Run, "run", LATCHED)
        self.create_subscription(
            BoardState,
            "relay_board/states",
            self._on_states,
            COMPLETE,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self.create_subscription(
            Heartbeat,
            "run_schedule/alive",
            lambda m: self._client_heartbeats.update(m.name, ACTIVE, time.monotonic()),
            COMPLETE,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self._action = ActionServer(
            self,
            RunSchedule,
            "run_schedule",
            execute_callback=self._execute,
            goal_callback=self._accept_or_reject,
            handle_accepted_callback=self._start_goal,
            cancel_callback=self._cancel,
            callback_group=ReentrantCallbackGroup(),
        )

    def open(self) -> None:
        self._rig = Rig.load(get_file(self, "rig"))

    def halt(self) -> None:
        self._end_runs("the sequencer was deactivated")

    def close(self) -> None:
        self._end_runs("the sequencer was shut down")
        self._rig = None

    def _end_runs(self, why: str) -> None:
        """End every goal, and wait until everything is off: later no command can be published any more."""
        self._interrupt(runs.STOPPED, why)
        with self._playing_lock:
            pass

    def _interrupt(self, outcome: int, why: str) -> None:
        """End every goal."""
        with self._goals_lock:
            self._interrupt_all(outcome, why)

    def _interrupt_all(self, outcome: int, why: str) -> None:
        """End every goal; the caller holds their lock."""
        for link in self._goals.values():
            link.bank.interrupt(outcome, why)

    def _on_states(self, message: BoardState) -> None:
        state = board.state_from(message)
        with self._goals_lock:
            for link in self._goals.values():
                link.bank.report(state)

    def _accept_or_reject(self, request: RunSchedule.Goal) -> GoalResponse:
        with self._goals_lock:
            return GoalResponse.REJECT if len(self._goals) >= _MAX_GOALS else GoalResponse.ACCEPT

    def _start_goal(self, goal: ServerGoalHandle) -> None:
        name, client = bytes(goal.goal_id.uuid), goal.request.client
        # The goal itself counts as a heartbeat.
        self._client_heartbeats.update(client, ACTIVE, time.monotonic())
        link = _GoalLink(self, goal, lambda: self._missing(client))
        with self._goals_lock:  # one step: of two goals at the same time the later one ends the earlier one
            self._interrupt_all(runs.PREEMPTED, "another schedule was sent")
            self._goals[name] = link
            if name in self._early_cancels:
                self._early_cancels.remove(name)
                link.bank.interrupt(runs.CANCELLED, "cancelled")
        goal.execute()

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        name = bytes(goal.goal_id.uuid)
        with self._goals_lock:
            if name in self._goals:
                self._goals[name].bank.interrupt(runs.CANCELLED, "cancelled")
            else:
                self._early_cancels.add(name)
        return CancelResponse.ACCEPT

    def _execute(self, goal: ServerGoalHandle) -> RunSchedule.Result:
        name = bytes(goal.goal_id.uuid)
        link = self._goals[name]
        try:
            with self._playing_lock:  # the goal before must have ended
                rig = self._rig if self.state == ACTIVE else None
                link.springs = () if rig is None else rig.spring_names
                request = RunRequest(
                    lambda: schedule_from(goal.request.schedule),
                    goal.request.client,
                    get_number(self, "lead_s"),
                    get_text(self, "accept_mismatch"),
                    lambda: runs.room_from(get_optional_value(self, "room_c")),
                )
                run = ScheduleRun(link.bank, link, lambda: self.now_ns)
                return link.conclude(run.play(request, rig, self.stopped))
        finally:
            with self._goals_lock:
                del self._goals[name]

    def _missing(self, client: str) -> tuple[str, ...]:
        """What a run lacks: its client, or required nodes that are not active."""
        now = time.monotonic()
        is_silent = self._client_heartbeats.state_of(client, now) == "silent"
        required = ("relay_board", *get_texts(self, "required_nodes"))
        lost = (f"the client {client} sends no heartbeats any more",) if is_silent else ()
        return lost + self.heartbeats.missing(required, now)


class _GoalLink:
    """The messages of one goal: commands to the relay board, feedback and result to the client."""

    def __init__(
        self, node: ActuationSequencerNode, goal: ServerGoalHandle, missing: Callable[[], tuple[str, ...]]
    ):
        self._node, self._goal = node, goal
        self._id = uuid.uuid4().hex[:8]
        self.bank = RemoteBank(self, self._id, missing, lambda: node.stopped)
        self.springs: tuple[str, ...] = ()

    # To the relay board.

    def send_command(self, command: int, sequence: int) -> None:
        self._node.commands.publish(HeatCommand(command=command, run=self._id, sequence=sequence))

    def send_pulses(self, delay: float, lengths: Mapping[int, float], sequence: int) -> None:
        self._node.commands.publish(runs.pulses_of(self._id, sequence, delay, lengths))

    # To everyone.

    def on_state(self, state: int, start_ns: int, message: str, room_c: float | None) -> None:
        run = runs.run_of(state, self._id, start_ns, self._goal.request.schedule, message, room_c)
        self._node.run_states.publish(run)

    def on_message(self, text: str) -> None:
        self._node.get_logger().info(f"run {self._id}: {text}")

    # To the client.

    def on_progress(self, progress: RunProgress) -> None:
        self._goal.publish_feedback(
            RunSchedule.Feedback(
                stamp=time_of(self._node.now_ns),
                elapsed=duration_of(progress.elapsed),
                phase=progress.phase,
                cycle=progress.cycle,
                latest_edge=[] if progress.edge is None else [runs.edge_of(progress.edge)],
                closed=list(progress.closed),
                springs=list(self.springs),
                temperatures=list(progress.temperatures),
            )
        )

    def conclude(self, result: RunScheduleResult) -> RunSchedule.Result:
        """End the goal; returns the action's result."""
        if result.outcome == runs.FINISHED:
            self._goal.succeed()
        elif result.outcome == runs.CANCELLED and self._goal.is_cancel_requested:
            self._goal.canceled()
        else:
            self._goal.abort()
        return RunSchedule.Result(
            outcome=result.outcome,
            message=result.message,
            start=time_of(result.start_ns),
            duration=duration_of(result.duration),
            peak_temperature=result.peak_temperature,
            max_delay=duration_of(result.max_delay),
            edges=[runs.edge_of(edge) for edge in result.edges],
            all_off=result.all_off,
        )


def main() -> None:
    """`ros2 run eldir_ros actuation_sequencer`."""
    request_realtime_priority(COMMANDS)
    spin([ActuationSequencerNode])
