"""The relay board: owns the guardian, which owns the port. Active means armed, anything else off."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any

from diagnostic_updater import FrequencyStatusParam, HeaderlessTopicDiagnostic

from eldir.errors import EldirError
from eldir_ros import parameters
from eldir_ros.conversions import board as convert
from eldir_ros.conversions import runs
from eldir_ros.messages import COMPLETE, LATCHED, RELIABLE, class_of, make
from eldir_ros.process import spin
from eldir_ros.rig_node import STOP, RigNode
from hardware.guardian.bank import Report
from hardware.guardian.client import Guardian
from hardware.rig.boards import open_board
from hardware.rig.configuration import Rig
from hardware.rig.port_lock import port_lock
from hardware.safety.latch import LatchedError, latch, require_unlatched, unlatch

_TICK = 0.05  # between two heartbeats for the guardian [s]
_PATIENCE = 0.6  # without a word from whoever heats, everything goes off [s]


class RelayBoard(RigNode):
    """Heats as HeatCommand says, and reports."""

    def __init__(self, **options: Any):
        super().__init__("relay_board", **options)
        parameters.text(self, "rig", "Rig file (YAML, eldir-rig/1).")
        parameters.text(self, "port", "Port of the board, instead of the rig file's.")
        self._guardian: Guardian | None = None
        self._armed = False
        self._run, self._heard = "", 0.0
        self._states = self.create_publisher(
            class_of("control_msgs/msg/DynamicJointState"), "~/states", RELIABLE
        )
        self._latched = self.create_publisher(class_of("eldir_msgs/msg/EmergencyStop"), STOP, LATCHED)
        self._heat: dict[str, Any] = {}
        self.create_subscription(
            class_of("eldir_msgs/msg/HeatCommand"), "~/commands", self._on_command, COMPLETE
        )
        trigger = class_of("std_srvs/srv/Trigger")
        self.create_service(trigger, "emergency_stop", self._on_emergency_stop)
        self.create_service(trigger, "reset_emergency_stop", self._on_reset)
        self.create_timer(_TICK, self._tick)
        self._rate = HeaderlessTopicDiagnostic(
            "states", self.diagnostics, FrequencyStatusParam({"min": 1.5, "max": 15.0})
        )
        self._tell_latch()

    # Lifecycle.

    def open(self) -> None:
        """Prove everything off, then hand the port to the guardian."""
        rig, port = self._rig()
        with port_lock(port), open_board(rig, port=port) as board:
            board.all_off()
        guardian = Guardian(rig, port)
        guardian.open()
        self._guardian = guardian
        for name in set(convert.spring_names(rig)) - set(self._heat):
            self._heat[name] = self.create_publisher(
                class_of("sensor_msgs/msg/Temperature"), f"springs/{name}/temperature", RELIABLE
            )
        self._rig_file = rig
        self.get_logger().info(f"{port}: all {rig.board.channels} channels are open")
        self._tell_latch()

    def start(self) -> None:
        self._guarding().arm()
        self._armed = True
        self.get_logger().info("armed")

    def rest(self) -> None:
        self._run = ""
        if self._guardian is not None and self._armed:
            self._armed = False
            self._guardian.disarm()
            self.get_logger().info("disarmed: everything is off")

    def close(self) -> None:
        try:
            self.rest()
        finally:
            guardian, self._guardian = self._guardian, None
            if guardian is not None:
                guardian.close()

    # What it is told.

    def _on_command(self, message: Any) -> None:
        if not self._armed:
            return
        if self._run and message.run != self._run:
            self.get_logger().warning(f"{message.run} wants to heat while {self._run} does: not heard")
            return
        if message.command in (message.BEAT, message.PULSES):
            self._run, self._heard = message.run, time.monotonic()
        if message.command == message.PULSES:
            stamp, lengths = runs.pulses_from(message)
            self._guarding().heat(time.monotonic() + 1e-9 * (stamp - self.now_ns), lengths)
        elif message.command in (message.CUT, message.END):
            self._guarding().cut()
            if message.command == message.END:
                self._run = ""

    def _on_emergency_stop(self, request: Any, response: Any) -> Any:
        try:
            self._stop("the emergency stop was called")
        except EldirError as error:
            response.message = str(error)
            self.trouble(response.message)
            return response
        response.success, response.message = True, "all contacts are open, by the board's report; latched"
        return response

    def _on_reset(self, request: Any, response: Any) -> Any:
        try:
            rig, port = self._rig()
            if self._armed:
                response.success, response.message = True, "armed: nothing to reset"
                return response
            self.close()
            with port_lock(port), open_board(rig, port=port) as board:
                board.all_off()
                unlatch(port)
        except EldirError as error:
            response.message = str(error)
            return response
        self._fall_back()
        self._tell_latch()
        response.success, response.message = True, "all contacts are open; now configure and activate"
        return response

    # What it does by itself.

    def _tick(self) -> None:
        if self._guardian is None:
            return
        try:
            self._guardian.beat(self._see)
            silent = time.monotonic() - self._heard
            if self._run and silent > _PATIENCE:
                raise EldirError(f"whoever heats was not heard for {silent:.1f} s")
        except EldirError as error:
            with suppress(EldirError):  # told by `_end`
                self._end(str(error))

    def _stop(self, why: str) -> None:
        """Everything off, proven and latched, whatever the state."""
        rig, port = self._rig()
        latch(port, why)
        if self._guardian is not None:
            self._end(why)
            return
        self._tell_latch(why)
        with port_lock(port), open_board(rig, port=port) as board:
            board.all_off()

    def _end(self, why: str) -> None:
        """Have the guardian switch everything off, if it has not yet; say so, and be unconfigured."""
        self._armed, self._run = False, ""
        try:
            self._guarding().stop(why)
        except EldirError as error:
            why = f"{why}; {error}"
            raise
        finally:
            self.close()
            self.trouble(why)
            self._tell_latch(why)
            self._fall_back()

    def _fall_back(self) -> None:
        if self.state == "active":
            self.trigger_deactivate()
        if self.state == "inactive":
            self.trigger_cleanup()

    def _see(self, report: Report) -> None:
        names = convert.spring_names(self._rig_file)
        stamp = self.now_ns - round(1e9 * (time.monotonic() - report.t))
        state = convert.BoardState(
            stamp,
            convert.channel_names(self._rig_file),
            report.closed,
            names,
            report.temperatures,
            self.state in ("activating", "active"),  # reports come while it arms, too
            report.hottest,
            report.latest,
        )
        self._states.publish(convert.states_of(make, state))
        for name, celsius in zip(names, report.temperatures, strict=True):
            self._heat[name].publish(convert.temperature_of(make, stamp, celsius))
        self._rate.tick()

    def _tell_latch(self, why: str = "") -> None:
        """Publish the emergency stop's state, as it is latched outside every program."""
        reason: str | None = None
        try:
            require_unlatched(self._rig()[1])
        except LatchedError as error:
            reason = why or str(error)
        except EldirError:  # without a rig file there is no port to be latched
            pass
        self._latched.publish(convert.stop_of(make, self.now_ns, reason))

    def _rig(self) -> tuple[Rig, str]:
        path = parameters.path(self, "rig")
        rig = Rig.load(path)  # type: ignore[arg-type]
        port = parameters.value(self, "port") or rig.board.port
        if not port:
            raise EldirError(
                f"{path} names no port", remedy="a virtual rig has one while virtual_bench runs: -p port:=..."
            )
        return rig, port

    def _guarding(self) -> Guardian:
        if self._guardian is None:
            raise EldirError("the relay board is not open", remedy="configure the node first")
        return self._guardian


def main() -> None:
    """`ros2 run eldir_ros relay_board`."""
    spin([RelayBoard])
