# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Base class of the rig's nodes: lifecycle, heartbeats, emergency stop, diagnostics."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper, Updater
from rclpy._rclpy_pybind11 import RCLError
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.timer import Timer

from eldir.errors import EldirError
from eldir_ros.base.interfaces import COMPLETE, LATCHED, declare_flag, get_value, message_class, new_message
from eldir_ros.remote.heartbeats import PERIOD, Heartbeats

_SHUTDOWN_TIMEOUT = 8.0  # until everything is off [s]
_RETRY_INTERVAL = 1.0  # between two attempts to start [s]
ALIVE, STOP = "alive", "emergency_stop"


class RigNode(LifecycleNode):
    """A node of the rig. Subclasses implement `open`, `start`, `halt` and `close`. Each may raise
    `EldirError`: the transition then fails, and the error is logged and shown in the diagnostics."""

    def __init__(self, name: str, **options: Any):
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        super().__init__(name, **options)
        self.heartbeats = Heartbeats()
        self.stopped = ""
        """Why the emergency stop is latched; empty while it is not."""
        self._fault, self._waiting_for = "", ""
        self._silent: set[str] = set()
        """Nodes whose heartbeats have stopped."""
        self._shut_down_event = threading.Event()
        self.transition = threading.RLock()
        """Held while the state changes, and by `listen`, `every` and `serve` while they work."""
        self._answer = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        declare_flag(self, "autostart", "Configure and activate once, as soon as possible.")
        self._starting = self.create_timer(_RETRY_INTERVAL, self._autostart)
        heartbeat = message_class("diagnostic_msgs/msg/KeyValue")
        stop = message_class("eldir_msgs/msg/EmergencyStop")
        self._alive = self.create_publisher(heartbeat, ALIVE, COMPLETE)
        self.create_subscription(heartbeat, ALIVE, self._on_heartbeat, COMPLETE, callback_group=_own_group())
        self.create_timer(PERIOD, self._send_heartbeat, _own_group())
        self.create_subscription(stop, STOP, self._on_stop, LATCHED, callback_group=_own_group())
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

    def advertise(self, kind: str, topic: str, quality: QoSProfile) -> Any:
        """A publisher of messages of a kind."""
        return self.create_publisher(message_class(kind), topic, quality)

    def listen(self, kind: str, topic: str, callback: Callable[[Any], None], quality: QoSProfile) -> None:
        """Subscribe. One message at a time is worked on, and never while the state of the lifecycle changes;
        a message that cannot be used is a fault, and not the end of the process."""

        def work(message: Any) -> None:
            with self.transition:
                try:
                    callback(message)
                except EldirError as error:
                    self.report_fault(str(error))
                except Exception as error:
                    self.report_fault(f"a message on {topic} is damaged: {type(error).__name__}: {error}")

        self.create_subscription(message_class(kind), topic, work, quality, callback_group=_own_group())

    def every(self, period: float, work: Callable[[], None]) -> None:
        """Do something every `period` [s], but not while a message is worked on or the state changes."""

        def tick() -> None:
            with self.transition:
                work()

        self.create_timer(period, tick, _own_group())

    def serve(self, kind: str, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Offer a service, which answers between messages and changes of the state."""

        def work(request: Any, response: Any) -> Any:
            with self.transition:
                return answer(request, response)

        self.create_service(message_class(kind), name, work, callback_group=_own_group())

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
        return str(self._state_machine.current_state[1])

    @property
    def now_ns(self) -> int:
        """ROS time [ns]: for stamps only, since `use_sim_time` and clock corrections change it."""
        return int(self.get_clock().now().nanoseconds)

    def report_fault(self, message: str) -> None:
        """Log a fault, and show it in the diagnostics until the next activation."""
        if message != self._fault:
            self.get_logger().error(message)
        self._fault = message

    def _on_change_state(self, request: Any, response: Any) -> Any:
        """As rclpy, but a transition that this state does not have is refused, and ends no process."""
        with self.transition:
            try:
                return self._answer(request, response)
            except RCLError as error:
                self.get_logger().error(f"invalid transition in state {self.state}: {error}".splitlines()[0])
                response.success = False
                return response

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.open, undo=self.close)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._fault = ""
        outcome = self._try(self.start)
        return super().on_activate(state) if outcome == TransitionCallbackReturn.SUCCESS else outcome

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._try(self.halt)
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.close)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.close)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.close)

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
        if not get_value(self, "autostart") or self.state in ("active", "finalized"):
            self._starting.cancel()
            return
        if self.state == "unconfigured":
            before, self._waiting_for = self._waiting_for, self.missing_device()
            if self._waiting_for:
                if self._waiting_for != before:
                    self.get_logger().info(f"waiting for {self._waiting_for}")
                return
            self.trigger_configure()
        if self.state == "inactive":
            self.trigger_activate()

    def _send_heartbeat(self) -> None:
        state = "finalized" if self._shut_down_event.is_set() else self.state
        self._alive.publish(new_message("diagnostic_msgs/msg/KeyValue", key=self.get_name(), value=state))
        for name in self.heartbeats.silent(time.monotonic()):
            self.heartbeats.forget(name)
            self._silent.add(name)
            self.get_logger().error(_silent_message(name))
            self.on_silent_node(name)

    def _on_heartbeat(self, message: Any) -> None:
        if message.key != self.get_name():
            self.heartbeats.update(message.key, message.value, time.monotonic())
            if message.key in self._silent:
                self._silent.discard(message.key)
                self.get_logger().info(f"{message.key} sends heartbeats again")

    def _on_stop(self, message: Any) -> None:
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
