"""The actuation sequencer: plays a schedule as an action; cancelled or preempted, everything is off."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Mapping
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup

from eldir.errors import EldirError
from eldir_ros.base import node_parameters
from eldir_ros.base.message_types import COMPLETE, LATCHED, message_class, new_message
from eldir_ros.base.rig_node import RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import board, runs, time_of
from eldir_ros.remote.remote_bank import RemoteBank
from hardware.clock import WallClock
from hardware.relay.errors import NotProvenOffError
from hardware.rig.configuration import Rig
from hardware.run.player import Player
from hardware.schedule import ActuationSchedule


class ActuationSequencerNode(RigNode):
    """Serves the action `run_schedule`, one goal at a time; a new goal preempts the one that runs."""

    def __init__(self, **options: Any):
        super().__init__("actuation_sequencer", **options)
        node_parameters.declare_text(self, "rig", "Rig file (YAML, eldir-rig/1).")
        node_parameters.declare_texts(self, "required_nodes", "Nodes without which nothing is heated.")
        node_parameters.declare_number(
            self, "lead", "From a goal until its schedule starts [s].", 1.5, 0.5, 30.0
        )
        self._rig: Rig | None = None
        self._bank: RemoteBank | None = None
        self._turn, self._naming = threading.Lock(), threading.Lock()
        self._commands = self.create_publisher(
            message_class("eldir_msgs/msg/HeatCommand"), "relay_board/commands", COMPLETE
        )
        self._run = self.create_publisher(message_class("eldir_msgs/msg/Run"), "run", LATCHED)
        self.create_subscription(
            message_class("control_msgs/msg/DynamicJointState"),
            "relay_board/states",
            self._on_states,
            COMPLETE,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self._action = ActionServer(
            self,
            message_class("eldir_msgs/action/RunSchedule"),
            "run_schedule",
            execute_callback=self._execute,
            handle_accepted_callback=self._accept,
            cancel_callback=self._cancel,
            callback_group=ReentrantCallbackGroup(),
        )

    def open(self) -> None:
        self._rig = Rig.load(node_parameters.get_path(self, "rig"))  # type: ignore[arg-type]

    def rest(self) -> None:
        self._interrupt(runs.STOPPED, "the sequencer was deactivated")

    def close(self) -> None:
        self._interrupt(runs.STOPPED, "the sequencer was shut down")
        with self._turn:
            self._rig = None

    def _interrupt(self, outcome: int, why: str) -> None:
        with self._naming:
            if self._bank is not None:
                self._bank.interrupt(outcome, why)

    def _on_states(self, message: Any) -> None:
        bank = self._bank
        if bank is not None:
            bank.report(board.state_from(message), self.now_ns)

    def _accept(self, goal: Any) -> None:
        self._interrupt(runs.PREEMPTED, "another schedule was sent")
        goal.execute()

    def _cancel(self, goal: Any) -> CancelResponse:
        self._interrupt(runs.CANCELLED, "cancelled")
        return CancelResponse.ACCEPT

    def _execute(self, goal: Any) -> Any:
        with self._turn:  # one after the other: the one before is ending
            run = _Run(self, goal)
            with self._naming:
                self._bank = run.bank
            try:
                return run.play(self._rig if self.state == "active" else None)
            finally:
                with self._naming:
                    self._bank = None


class _Run:
    """One goal, from its acceptance to its result."""

    def __init__(self, node: ActuationSequencerNode, goal: Any):
        self._node, self._goal = node, goal
        self._id = uuid.uuid4().hex[:8]
        self.bank = RemoteBank(self, self._missing, lambda: node.stopped)
        self._edges = runs.Edges()
        self._start_ns = 0
        self._closed: tuple[bool, ...] = ()
        self._schedule: ActuationSchedule | None = None
        self._rig: Rig | None = None

    def play(self, rig: Rig | None) -> Any:
        """Play the goal's schedule and return its result."""
        node, self._rig = self._node, rig
        told = False
        try:
            if rig is None:
                raise EldirError("the sequencer is not active", remedy="activate it")
            if node.stopped:
                raise EldirError(f"the emergency stop is latched: {node.stopped}", remedy="reset it")
            self._schedule = runs.schedule_from(self._goal.request.schedule)
            clock = WallClock()
            player = Player(self.bank, self._schedule, rig, clock, [self])
            lead = node_parameters.get_value(node, "lead")
            start = clock.now() + lead
            self._start_ns = node.now_ns + round(1e9 * lead)
            told = True
            self._tell(runs.RUNNING, "")
            node.get_logger().info(f"run {self._id}: {self._schedule.duration:.1f} s")
            player.play(start)
            outcome, message, proven = runs.FINISHED, "played to the end", True
        except EldirError as error:
            outcome = getattr(error, "outcome", runs.STOPPED if told else runs.REFUSED)
            message, proven = str(error), not isinstance(error, NotProvenOffError)
        if told:
            self._tell(runs.RUN_FINISHED if outcome == runs.FINISHED else runs.RUN_ENDED, message)
        node.get_logger().info(f"run {self._id}: {message}")
        self._conclude(outcome)
        last = self.bank.last
        return new_message(
            "eldir_msgs/action/RunSchedule_Result",
            outcome=outcome,
            message=message,
            start=time_of(new_message, self._start_ns),
            duration=1e-9 * (node.now_ns - self._start_ns) if told else 0.0,
            hottest=0.0 if last is None else last.hottest,
            latest=0.0 if last is None else last.latest,
            edges=[runs.edge_of(new_message, e) for e in self._edges.found],
            all_off=proven,
        )

    def _conclude(self, outcome: int) -> None:
        if outcome == runs.FINISHED:
            self._goal.succeed()
        elif outcome == runs.CANCELLED and self._goal.is_cancel_requested:
            self._goal.canceled()
        else:
            self._goal.abort()

    # The line to the relay board.

    def tell(self, command: int) -> None:
        self._node._commands.publish(new_message("eldir_msgs/msg/HeatCommand", command=command, run=self._id))

    def announce(self, at: float, lengths: Mapping[int, float]) -> None:
        stamp = self._node.now_ns + round(1e9 * (at - time.monotonic()))
        self._node._commands.publish(runs.pulses_of(new_message, self._id, stamp, dict(lengths)))

    # What the player observes.

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        self._edges.see(t, states)
        self._closed = states

    def on_temperatures(self, t: float, temperatures: tuple[float, ...]) -> None:
        assert self._schedule is not None and self._rig is not None
        edges = self._edges.found or [(0.0, 0, False)]
        self._goal.publish_feedback(
            new_message(
                "eldir_msgs/action/RunSchedule_Feedback",
                stamp=time_of(new_message, self._node.now_ns),
                elapsed=t,
                cycle=runs.cycle_at(self._schedule, t),
                edge=runs.edge_of(new_message, edges[-1]),
                closed=[i for i, closed in enumerate(self._closed, start=1) if closed],
                springs=list(board.spring_names(self._rig)),
                temperatures=list(temperatures),
            )
        )

    def on_event(self, t: float, text: str) -> None:
        self._node.get_logger().info(f"run {self._id} at {t:.1f} s: {text}")

    def _missing(self) -> tuple[str, ...]:
        wanted = ("relay_board", *node_parameters.get_value(self._node, "required_nodes"))
        return self._node.beats.missing(wanted, time.monotonic())

    def _tell(self, state: int, message: str) -> None:
        text = self._goal.request.schedule
        self._node._run.publish(runs.run_of(new_message, state, self._id, self._start_ns, text, message))


def main() -> None:
    """`ros2 run eldir_ros actuation_sequencer`."""
    spin([ActuationSequencerNode])
