"""What all nodes of the rig have: a lifecycle, beats that show they are alive, the emergency stop."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper, Updater
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from eldir.errors import EldirError
from eldir_ros.base import node_parameters
from eldir_ros.base.message_types import COMPLETE, LATCHED, message_class, new_message
from eldir_ros.remote.heartbeats import PERIOD, Heartbeats

_LEAVING = 8.0  # everything must be off by then [s]
_AGAIN = 1.0  # from one try to start to the next [s]
ALIVE, STOP = "alive", "emergency_stop"


class RigNode(LifecycleNode):
    """A node of the rig. Subclasses fill `open`, `start`, `rest` and `close`, each of which may raise
    `EldirError`: the transition then fails with its one line."""

    def __init__(self, name: str, **options: Any):
        super().__init__(name, **options)
        self.beats = Heartbeats()
        self.stopped = ""
        """Why the emergency stop is latched; empty while it is not."""
        self._trouble = ""
        self._left = threading.Event()
        node_parameters.declare_flag(
            self, "autostart", "Configure and activate once, as soon as it can be done.", False
        )
        self._starting = self.create_timer(_AGAIN, self._autostart)
        # Of their own: a node that is busy is not dead, and hears who is.
        beating, hearing = MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()
        beat = message_class("diagnostic_msgs/msg/KeyValue")
        self._alive = self.create_publisher(beat, ALIVE, COMPLETE)
        self.create_subscription(beat, ALIVE, self._hear, COMPLETE, callback_group=hearing)
        self.create_timer(PERIOD, self._beat, callback_group=beating)
        self.create_subscription(message_class("eldir_msgs/msg/EmergencyStop"), STOP, self._on_stop, LATCHED)
        self.diagnostics = Updater(self)
        self.diagnostics.setHardwareID("eldir")
        self.diagnostics.add("state", self._diagnose)

    # What subclasses do.

    def open(self) -> None:
        """Get ready: configure."""

    def start(self) -> None:
        """Begin to work: activate."""

    def rest(self) -> None:
        """Stop working: deactivate."""

    def close(self) -> None:
        """Give everything back: cleanup, and every way out. Harmless when it has happened."""

    def obey_stop(self, reason: str) -> None:
        """The emergency stop was latched."""

    def miss(self, name: str) -> None:
        """Another node of the rig has fallen silent."""

    # What is the same for all.

    @property
    def state(self) -> str:
        """Of the lifecycle, such as active."""
        return str(self._state_machine.current_state[1])

    @property
    def now_ns(self) -> int:
        """ROS time."""
        return int(self.get_clock().now().nanoseconds)

    def trouble(self, message: str) -> None:
        """Tell of something that is wrong, in the log and in the diagnostics until the next start."""
        if message != self._trouble:
            self.get_logger().error(message)
        self._trouble = message

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.open, undo=self.close)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._trouble = ""
        outcome = self._try(self.start)
        return super().on_activate(state) if outcome == TransitionCallbackReturn.SUCCESS else outcome

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._try(self.rest)
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.close)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.close)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.close)

    def leave(self) -> None:
        """The process ends: everything off, and nobody needs to miss this node. Call it from outside."""
        self.create_timer(1e-3, self._leave)  # in turn with whatever else the node does
        self._left.wait(_LEAVING)

    def _leave(self) -> None:
        if not self._left.is_set():
            self._try(self.close)
            self._left.set()
            self._beat()

    def _try(
        self, action: Callable[[], None], undo: Callable[[], None] = lambda: None
    ) -> TransitionCallbackReturn:
        try:
            action()
        except EldirError as error:
            undo()
            self.trouble(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # rclpy would swallow it
            undo()
            self.trouble(f"{type(error).__name__}: {error}")
            self.get_logger().debug(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _autostart(self) -> None:
        """A node that has been started once is never started again by itself."""
        if not node_parameters.get_value(self, "autostart") or self.state in ("active", "finalized"):
            self._starting.cancel()
            return
        if self.state == "unconfigured":
            self.trigger_configure()
        if self.state == "inactive":
            self.trigger_activate()

    def _beat(self) -> None:
        state = "finalized" if self._left.is_set() else self.state
        self._alive.publish(new_message("diagnostic_msgs/msg/KeyValue", key=self.get_name(), value=state))
        for name in self.beats.silent(time.monotonic()):
            self.beats.forget(name)
            self.trouble(f"{name} has fallen silent")
            self.miss(name)

    def _hear(self, message: Any) -> None:
        if message.key != self.get_name():
            self.beats.hear(message.key, message.value, time.monotonic())

    def _on_stop(self, message: Any) -> None:
        before, self.stopped = self.stopped, message.reason if message.stopped else ""
        if self.stopped and self.stopped != before:
            self.get_logger().error(f"emergency stop: {self.stopped}")
            self.obey_stop(self.stopped)

    def _diagnose(self, status: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        wrong = [f"emergency stop: {self.stopped}"] if self.stopped else []
        if self._trouble:
            wrong.append(self._trouble)
        if wrong:
            status.summary(DiagnosticStatus.ERROR, "; ".join(wrong))
        else:
            status.summary(DiagnosticStatus.OK, self.state)
        status.add("state", self.state)
        return status
