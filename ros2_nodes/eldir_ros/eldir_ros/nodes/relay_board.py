# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The relay board: owns the guardian, which owns the port. Active means armed, every other state all off."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack, suppress
from typing import Any

from control_msgs.msg import DynamicJointState
from diagnostic_updater import FrequencyStatusParam, HeaderlessTopicDiagnostic
from eldir_msgs.msg import BoardState, EmergencyStop, HeatCommand
from rclpy.publisher import Publisher
from sensor_msgs.msg import Temperature
from std_srvs.srv import Trigger

from eldir.errors import EldirError
from eldir_hardware.guardian.bank import BOARD_PROOF, Commander, Report
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.off_proof import prove_off, proven_open, reset_emergency_stop
from eldir_hardware.realtime import COMMANDS, request_realtime_priority
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.rig.board_identity import Port
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.latch import LatchedError, latch, read_stop, require_unlatched
from eldir_ros.base.parameters import get_file, get_text
from eldir_ros.base.qualities import COMPLETE, LATCHED, RELIABLE
from eldir_ros.base.rig_node import ACTIVATING, ACTIVE, STOP, RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import board as convert
from eldir_ros.conversions import runs
from eldir_ros.remote.remote_bank import ObeyedCommands

_KEEPALIVE_INTERVAL = 0.05  # of messages to the guardian [s]


class RelayBoardNode(RigNode):
    """Heats as the messages HeatCommand say, and publishes the reports of the board."""

    def __init__(self, **options: Any):
        super().__init__("relay_board", **options)
        self._guardian: Guardian | None = None
        self._board: Port | None = None
        """The board that was opened last, whatever its port or the rig file names now."""
        self._open_rig: Rig
        """The rig of that board, as its file was then."""
        self._opened = ExitStack()
        self._armed = False
        self._commander = Commander()
        self._obeyed = ObeyedCommands()
        self._last: Report | None = None
        """The latest report since the port was opened."""
        self._states = self.advertise(BoardState, "~/states", RELIABLE)
        self._relays, self._currents, self._voltages = (
            self.advertise(DynamicJointState, name, RELIABLE) for name in ("relays", "currents", "voltages")
        )
        self._stop_state = self.announce(EmergencyStop, STOP, LATCHED)
        self._temperatures: dict[str, Publisher[Temperature]] = {}
        self.listen(HeatCommand, "~/commands", self._on_command, COMPLETE)
        self.serve(Trigger, "emergency_stop", self._on_emergency_stop)
        self.serve(Trigger, "reset_emergency_stop", self._on_reset)
        self.every(_KEEPALIVE_INTERVAL, self._tick)
        self._rate = HeaderlessTopicDiagnostic(
            "states", self.diagnostics, FrequencyStatusParam({"min": 1.5, "max": 15.0})
        )
        self._publish_stop_state()

    # Lifecycle.

    def missing_device(self) -> str:
        with suppress(EldirError):  # reported when the node is configured
            port = self._rig()[1]
            if not os.path.exists(port):
                return f"the relay board's port {port}"
        return ""

    def open(self) -> None:
        """Prove everything off, then hand the port to the guardian."""
        rig, port = self._rig()
        with proven_open(rig, port) as (board, _):
            self._board, self._open_rig = board, rig
        self._last = None
        self._guardian = self._opened.enter_context(Guardian(rig, port))
        for name in set(rig.spring_names) - set(self._temperatures):
            self._temperatures[name] = self.advertise(Temperature, f"springs/{name}/temperature", RELIABLE)
        self.get_logger().info(f"{port}: all {rig.board.channels} channels are open")
        self._publish_stop_state()

    def start(self) -> None:
        require_unlatched(self._find_board()[1])  # the guardian refuses as well, and would end
        guardian = self._open_guardian()
        guardian.arm()
        self._armed = True
        self.get_logger().info("armed")
        if (rest := guardian.ready_at - time.monotonic()) > 0:
            self.get_logger().warning(
                f"springs are still warm: a run that begins within {rest:.0f} s is stopped"
            )

    def halt(self) -> None:
        self._commander.release()
        if self._guardian is not None and self._armed:
            self._armed = False
            try:
                self._guardian.disarm()
            except EldirError as error:  # the guardian has latched the stop
                self._publish_stop_state(str(error))
                raise
            self._publish_off()
            self.get_logger().info("disarmed: everything is off")

    def close(self) -> None:
        try:
            self.halt()
        finally:
            self._guardian = None
            self._opened.close()

    # Commands and services.

    def _on_command(self, message: HeatCommand) -> None:
        if not self._armed:
            return
        try:
            self._obey(message)
        except Exception as error:  # the sender of damaged commands must not heat
            self._fail(EldirError(f"a command of run {message.run!r} is damaged: {error}"))

    def _obey(self, message: HeatCommand) -> None:
        if not message.run:
            raise ValueError("run is empty")
        if not self._commander.accepts(message.run):
            self.get_logger().warning(
                f"ignored a command of run {message.run}: run {self._commander.name} is heating"
            )
            return
        self._obeyed.require_new(message.run, message.sequence)
        if message.command in (message.KEEPALIVE, message.PULSES):
            self._commander.record_command(message.run, time.monotonic())
        if message.command == message.PULSES:
            delay, lengths = runs.pulses_from(message)
            self._open_guardian().heat(time.monotonic() + delay, lengths)
        elif message.command in (message.ABORT, message.END_OF_RUN):
            self._open_guardian().abort_pulses()
            if message.command == message.END_OF_RUN:
                self._commander.release()
        elif message.command != message.KEEPALIVE:
            raise ValueError(f"its command is {message.command}")
        self._obeyed.add(message.run, message.sequence, time.monotonic())

    def _on_emergency_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = self._stop("the emergency stop was called")
        except EldirError as error:
            response.message = str(error)
            self.report_fault(response.message)
            return response
        response.success = True
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            rig, port = self._rig()
            if self._armed:
                response.success, response.message = True, "armed: nothing to reset"
                return response
            self.close()
            measured = reset_emergency_stop(rig, port)
        except EldirError as error:
            response.message = str(error)
            return response
        self.become_unconfigured()
        self._publish_stop_state()
        shown = f"; {measured}" if measured else ""
        response.success, response.message = True, f"{BOARD_PROOF}{shown}; now configure and activate"
        return response

    # Timer and faults.

    def _tick(self) -> None:
        if self._guardian is None:
            return
        try:
            self._guardian.keep_alive(self._publish_report)
            silent = self._commander.silence_if_lost(time.monotonic())
            if silent is not None:
                raise EldirError(f"run {self._commander.name} sent no command for {silent:.1f} s")
        except EldirError as error:
            self._fail(error)

    def _fail(self, error: EldirError) -> None:
        """Everything off after a fault; the stop is latched."""
        with suppress(EldirError):  # reported by `_end`
            self._end(str(error), proven=not isinstance(error, NotProvenOffError))

    def _stop(self, why: str) -> str:
        """Everything off, proven, then latched, in every state; returns what was proven.

        While a guardian holds the board the rig file is not read: it may be damaged or gone.
        """
        rig, board = self._find_board()
        guardian, proof = self._guardian, None
        try:
            if guardian is not None:
                self._end(why)
                proof = guardian.proof
            if proof is None:  # no guardian, or one that ended before it was armed
                proof = prove_off(rig or self._rig()[0], board)
        finally:
            problem = latch(board, why, opened=proof is not None)
            self._publish_stop_state(why, board)
        if problem:
            raise EldirError(f"{proof}, but the stop is not latched: {problem}")
        return f"{proof}; latched"

    def _end(self, why: str, proven: bool = True) -> None:
        """Have the guardian switch everything off, if it has not yet; report why, and be unconfigured.

        `proven`: where the guardian has ended, whether it has proven everything off.
        """
        self._armed = False
        self._commander.release()
        board = self._find_board()[1]
        try:
            self._open_guardian().stop(why)
            if proven:
                self._publish_off()
        except EldirError as error:
            why = f"{why}; {error}"
            raise
        finally:
            self.close()
            self.report_fault(why)
            self._publish_stop_state(why, board)
            self.become_unconfigured()

    def _publish_off(self) -> None:
        """Publish what was just proven: all contacts are open, and the board is not armed."""
        if self._last is not None:
            off = (False,) * len(self._last.closed)
            self._publish_report(self._last._replace(t=time.monotonic(), closed=off), armed=False)

    def _publish_report(self, report: Report, armed: bool = True) -> None:
        self._last = report
        names, channels = self._open_rig.spring_names, self._open_rig.channel_names
        age = time.monotonic() - report.t
        stamp = self.now_ns - round(1e9 * age)
        state = convert.BoardState(
            stamp,
            age,
            *self._obeyed.before(report.t),
            armed and self.state in (ACTIVATING, ACTIVE),  # the board also reports while it arms
            channels,
            report.closed,
            names,
            report.temperatures,
            report.peak,
            report.max_delay,
            report.currents,
            report.voltages,
        )
        self._states.publish(convert.states_of(state))
        self._relays.publish(convert.contacts_of(stamp, channels, report.closed))
        if report.currents:
            self._currents.publish(convert.currents_of(stamp, names, report.currents))
        if report.voltages:
            self._voltages.publish(convert.voltages_of(stamp, names, report.voltages))
        for name, celsius in zip(names, report.temperatures, strict=True):
            self._temperatures[name].publish(convert.temperature_of(stamp, celsius))
        self._rate.tick()

    def _publish_stop_state(self, why: str = "", board: Port | None = None) -> None:
        """Publish whether the emergency stop is latched, by the record of the board, which keeps the first
        reason; `why` counts where it has none."""
        reason: str | None = None
        with suppress(EldirError):  # without a rig file there is no port that could be latched
            board = board or self._find_board()[1]
            try:
                require_unlatched(board)
            except LatchedError as error:
                reason = why or str(error)
                reason = read_stop(board) or reason
        self._stop_state.publish(convert.stop_of(self.now_ns, reason))

    def _find_board(self) -> tuple[Rig | None, Port]:
        """Rig and board of the guardian; without one those of the rig file, or if that cannot be read those
        that were opened last, or the port of the parameter alone."""
        if self._guardian is None:
            with suppress(EldirError):
                return self._rig()
        if self._board is not None:
            return self._open_rig, self._board
        if port := get_text(self, "port"):
            return None, port
        return self._rig()  # raises why it cannot be read

    def _rig(self) -> tuple[Rig, str]:
        path = get_file(self, "rig")
        rig = Rig.load(path)
        port = get_text(self, "port") or rig.board.port
        if not port:
            raise EldirError(
                f"{path} names no port",
                remedy="set the parameter port; for a virtual rig to the port of virtual_bench",
            )
        return rig, port

    def _open_guardian(self) -> Guardian:
        if self._guardian is None:
            raise EldirError("the relay board is not open", remedy="configure the node first")
        return self._guardian


def main() -> None:
    """`ros2 run eldir_ros relay_board`."""
    request_realtime_priority(COMMANDS)
    spin([RelayBoardNode])
