# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Base class of the rig's nodes: lifecycle, heartbeats, emergency stop, diagnostics."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper, Updater
from eldir_msgs.msg import EmergencyStop, Heartbeat
from lifecycle_msgs.msg import State
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.timer import Timer

from eldir.errors import EldirError
from eldir_ros.base.parameters import declare_parameters, get_flag
from eldir_ros.base.qualities import COMPLETE, LATCHED
from eldir_ros.conversions import time_of
from eldir_ros.remote.heartbeats import PERIOD, Heartbeats

_SHUTDOWN_TIMEOUT = 8.0  # until everything is off [s]
_RETRY_INTERVAL = 1.0  # between two attempts to start [s]
ALIVE, STOP = "alive", "emergency_stop"
UNCONFIGURED, INACTIVE, ACTIVATING, ACTIVE, DEACTIVATING, FINALIZED = (
    "unconfigured",
    "inactive",
    "activating",
    "active",
    "deactivating",
    "finalized",
)
"""States of the lifecycle."""
_IDS = {
    UNCONFIGURED: State.PRIMARY_STATE_UNCONFIGURED,
    INACTIVE: State.PRIMARY_STATE_INACTIVE,
    ACTIVATING: State.TRANSITION_STATE_ACTIVATING,
    ACTIVE: State.PRIMARY_STATE_ACTIVE,
    DEACTIVATING: State.TRANSITION_STATE_DEACTIVATING,
    FINALIZED: State.PRIMARY_STATE_FINALIZED,
}
_Message = TypeVar("_Message")
_Service = TypeVar("_Service")


class RigNode(LifecycleNode):
    """A node of the rig. Subclasses implement `open`, `start`, `halt` and `close`. Each may raise
    `EldirError`: the transition then fails, and the error is logged and shown in the diagnostics."""

    def __init__(self, name: str, **options: Any):
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        super().__init__(name, **options)
        self.heartbeats = Heartbeats()
        self.stopped = ""
        """Why the emergency stop is latched; empty while it is not."""
        self._state = UNCONFIGURED
        self._fault, self._waiting_for = "", ""
        self._silent: set[str] = set()
        """Nodes whose heartbeats have stopped."""
        self._shut_down_event = threading.Event()
        self.transition = threading.RLock()
        """Held while a transition works, and by `listen`, `every` and `serve` while they work."""
        declare_parameters(self, name)
        self._starting = self.create_timer(_RETRY_INTERVAL, self._autostart)
        self._alive = self.announce(Heartbeat, ALIVE, COMPLETE)
        self.create_subscription(Heartbeat, ALIVE, self._on_heartbeat, COMPLETE, callback_group=_own_group())
        self.create_timer(PERIOD, self._send_heartbeat, _own_group())
        self.create_subscription(EmergencyStop, STOP, self._on_stop, LATCHED, callback_group=_own_group())
        if self.get_namespace() != "/":
            self.declare_parameter("diagnostic_updater.use_fqn", True)  # /diagnostics is for all rigs
        self.diagnostics = Updater(self)
        self.diagnostics.setHardwareID("eldir")
        self.diagnostics.add("state", self._diagnose)

    # What subclasses implement.

    def open(self) -> None:
        """Configure: load files, open devices."""

    def start(self) -> None:
        """Activate: begin to work."""

    def halt(self) -> None:
        """Deactivate: stop working."""

    def close(self) -> None:
        """Release everything: at cleanup, on errors and at the end of the process; may be called twice."""

    def on_emergency_stop(self, reason: str) -> None:
        """The emergency stop was latched."""

    def on_silent_node(self, name: str) -> None:
        """Another node of the rig sends no heartbeats any more."""

    def missing_device(self) -> str:
        """The device without which the node cannot be configured, if it is missing; `autostart` waits for
        it."""
        return ""

    # What is the same for all.

    # Each of these has a callback group of its own, and they take turns by the lock `transition`. In a common
    # group the executor would always take the first that is ready, in the order in which they were made, and
    # timers first of all: with a picture always waiting, nothing else would ever be heard.

    def advertise(self, kind: type[_Message], topic: str, quality: QoSProfile) -> Publisher[_Message]:
        """A publisher that sends only while the node is active, or is being activated or deactivated."""
        return self.create_lifecycle_publisher(kind, topic, quality)

    def announce(self, kind: type[_Message], topic: str, quality: QoSProfile) -> Publisher[_Message]:
        """A publisher of the state of the node itself, which an inactive node has too."""
        return self.create_publisher(kind, topic, quality)

    def listen(
        self, kind: type[_Message], topic: str, callback: Callable[[_Message], None], quality: QoSProfile
    ) -> None:
        """Subscribe. One message at a time is worked on, and never while the state of the lifecycle changes;
        a message that cannot be used is a fault, and not the end of the process."""

        def work(message: _Message) -> None:
            with self.transition:
                try:
                    callback(message)
                except EldirError as error:
                    self.report_fault(str(error))
                except Exception as error:
                    self.report_fault(f"a message on {topic} is damaged: {type(error).__name__}: {error}")

        self.create_subscription(kind, topic, work, quality, callback_group=_own_group())

    def every(self, period: float, work: Callable[[], None]) -> None:
        """Do something every `period` [s], but not while a message is worked on or the state changes."""

        def tick() -> None:
            with self.transition:
                work()

        self.create_timer(period, tick, _own_group())

    def serve(self, kind: type[_Service], name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Offer a service, which answers between messages and changes of the state."""

        def work(request: Any, response: Any) -> Any:
            with self.transition:
                return answer(request, response)

        self.create_service(kind, name, work, callback_group=_own_group())

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[[], None],
        callback_group: CallbackGroup | None = None,
        clock: Clock | None = None,
        autostart: bool = True,
    ) -> Timer:
        """As rclpy, but by the steady clock: neither `use_sim_time` nor a correction of the time of day may
        delay a heartbeat."""
        clock = clock or self._steady
        return super().create_timer(timer_period_sec, callback, callback_group, clock, autostart)

    @property
    def state(self) -> str:
        """State of the lifecycle, such as active."""
        return self._state

    @property
    def now_ns(self) -> int:
        """ROS time [ns]: for stamps only, since `use_sim_time` and clock corrections change it."""
        return int(self.get_clock().now().nanoseconds)

    def report_fault(self, message: str) -> None:
        """Log a fault, and show it in the diagnostics until the next activation."""
        if message != self._fault:
            self.get_logger().error(message)
        self._fault = message

    # rclpy has no public property for the state, so it is noted where the transitions end.

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._change(self.open, INACTIVE, otherwise=UNCONFIGURED, undo=self.close)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        with self.transition:
            self._fault, self._state = "", ACTIVATING
            super().on_activate(state)  # first: what `start` begins may publish at once
            outcome = self._change(self.start, ACTIVE, otherwise=INACTIVE)
            if outcome != TransitionCallbackReturn.SUCCESS:
                super().on_deactivate(state)
            return outcome

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        with self.transition:
            self._state = DEACTIVATING
            outcome = self._change(self.halt, INACTIVE, otherwise=DEACTIVATING)
            super().on_deactivate(state)  # last: `halt` may publish how it ended
            # `on_error` closes what could not be halted.
            return outcome if outcome == TransitionCallbackReturn.SUCCESS else TransitionCallbackReturn.ERROR

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._change(self.close, UNCONFIGURED, otherwise=INACTIVE)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        with self.transition:
            outcome = self._change(self.close, FINALIZED, otherwise=FINALIZED)
            super().on_deactivate(state)
            return outcome

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        with self.transition:
            outcome = self._change(self.close, UNCONFIGURED, otherwise=FINALIZED)
            super().on_deactivate(state)
            return outcome

    def become_unconfigured(self) -> None:
        """Deactivate and clean up, whatever the state is."""
        with suppress(
            RuntimeError
        ):  # of rclpy: a transition that another thread has begun waits for this one
            if self.state == ACTIVE:
                self.trigger_deactivate()
            if self.state == INACTIVE:
                self.trigger_cleanup()

    def shut_down(self) -> None:
        """Switch everything off before the process ends; call it from a thread that runs no callbacks.

        With the last heartbeat the other nodes know that this one shut down cleanly, which is no fault.
        """
        self.create_timer(1e-3, self._shut_down)  # one after the other with the other callbacks
        self._shut_down_event.wait(_SHUTDOWN_TIMEOUT)

    def _shut_down(self) -> None:
        if not self._shut_down_event.is_set():
            self._try(self.close)
            self._shut_down_event.set()
            self._send_heartbeat()

    def _change(
        self,
        action: Callable[[], None],
        then: str,
        otherwise: str,
        undo: Callable[[], None] = lambda: None,
    ) -> TransitionCallbackReturn:
        with self.transition:
            outcome = self._try(action, undo)
            self._state = then if outcome == TransitionCallbackReturn.SUCCESS else otherwise
            return outcome

    def _try(
        self, action: Callable[[], None], undo: Callable[[], None] = lambda: None
    ) -> TransitionCallbackReturn:
        with self.transition:
            try:
                action()
            except EldirError as error:
                undo()
                self.report_fault(str(error))
                return TransitionCallbackReturn.FAILURE
            except Exception as error:  # rclpy would hide it
                undo()
                self.report_fault(f"{type(error).__name__}: {error}")
                self.get_logger().debug(traceback.format_exc())
                return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _autostart(self) -> None:
        """Configure and activate once; a node that was active before is not started again."""
        if not get_flag(self, "autostart") or self.state in (ACTIVE, FINALIZED):
            self._starting.cancel()
            return
        if self.state == UNCONFIGURED:
            before, self._waiting_for = self._waiting_for, self.missing_device()
            if self._waiting_for:
                if self._waiting_for != before:
                    self.get_logger().info(f"waiting for {self._waiting_for}")
                return
            self.trigger_configure()
        if self.state == INACTIVE:
            self.trigger_activate()

    def _send_heartbeat(self) -> None:
        label = FINALIZED if self._shut_down_event.is_set() else self.state
        state = State(id=_IDS[label], label=label)
        self._alive.publish(Heartbeat(stamp=time_of(self.now_ns), name=self.get_name(), state=state))
        for name in self.heartbeats.silent(time.monotonic()):
            self.heartbeats.forget(name)
            self._silent.add(name)
            self.get_logger().error(_silent_message(name))
            self.on_silent_node(name)

    def _on_heartbeat(self, message: Heartbeat) -> None:
        if message.name != self.get_name():
            self.heartbeats.update(message.name, message.state.label, time.monotonic())
            if message.name in self._silent:
                self._silent.discard(message.name)
                self.get_logger().info(f"{message.name} sends heartbeats again")

    def _on_stop(self, message: EmergencyStop) -> None:
        before, self.stopped = self.stopped, message.reason if message.stopped else ""
        if self.stopped and self.stopped != before:
            self.get_logger().error(f"emergency stop: {self.stopped}")
            self.on_emergency_stop(self.stopped)

    def _diagnose(self, status: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        problems = [f"emergency stop: {self.stopped}"] if self.stopped else []
        if self._fault and self._fault != self.stopped:
            problems.append(self._fault)
        problems += map(_silent_message, sorted(self._silent))
        if problems:
            status.summary(DiagnosticStatus.ERROR, "; ".join(problems))
        elif self._waiting_for:
            status.summary(DiagnosticStatus.WARN, f"waiting for {self._waiting_for}")
        else:
            status.summary(DiagnosticStatus.OK, self.state)
        status.add("state", self.state)
        return status


_own_group = MutuallyExclusiveCallbackGroup
"""A callback group of its own: the callback waits for no other, and does not run twice at once."""


def _silent_message(name: str) -> str:
    return f"{name} sends no heartbeats any more"
