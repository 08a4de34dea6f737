"""The guardian: a separate process that alone owns the port of a relay board.

It heats only while keepalive messages come. It switches everything off, proven by read-back, when they stop,
when its parent's end of the socket closes (also by SIGKILL), and on SIGTERM (`eldir rig off`).
Started by `eldir_hardware.guardian.client`, in the isolation of `eldir_hardware.guardian._connection`.
"""

from __future__ import annotations

import gc
import logging
import os
import select
import signal
import socket
import sys
import time
from contextlib import suppress
from functools import partial
from typing import Any

from eldir.core import program_log
from eldir.errors import EldirError, print_line
from eldir_hardware.clock import EMULATED_PATIENCE, WallClock
from eldir_hardware.guardian._connection import GuardianConnection
from eldir_hardware.guardian.bank import Report, describe_reason
from eldir_hardware.guardian.measured_heat import CurrentFlowsError, sensor_entries
from eldir_hardware.guardian.pulse_controller import Host, KeepaliveError, PulseController
from eldir_hardware.realtime import GUARDIAN, request_realtime_priority
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.rig.board_identity import BoardIdentity, Port, describe_move, identify_open
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import open_board, open_sensor
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import (
    end_driving,
    latch,
    latch_for_driving,
    require_not_stopped,
    require_unlatched,
)
from eldir_hardware.safety.spring_memory import Springs, load_springs, save_springs, springs_at_limit
from eldir_hardware.safety.stop_signals import StoppedError

_logger = logging.getLogger(__name__)
_START_TIMEOUT = 5.0  # until the parent's first message [s]


class ParentDiedError(EldirError):
    """The program that heats has died."""

    code = "guardian.orphaned"


class _Session:
    """One parent, one board."""

    def __init__(
        self,
        connection: GuardianConnection,
        controller: PulseController,
        rig: Rig,
        port: Port,
        sensor: BoardIdentity | None = None,
    ):
        """`port`, `sensor`: the devices themselves, whatever their names refer to later."""
        self._connection, self._controller, self._rig, self._port = connection, controller, rig, port
        self._sensor = sensor
        self._signals, write = os.pipe()
        os.set_blocking(write, False)
        signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, lambda *_: None)  # read from the pipe, never in the middle of a command
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
        controller.on_report = self._report

    def run(self) -> None:
        """Serve until the parent ends the session. Raises `EldirError` for any other end."""
        try:
            self._serve()
        except EldirError:
            # `eldir rig off` itself opens the contacts: the signal is the cause, not the report of the board.
            if self._has_signal():
                raise self._signal_error() from None
            raise

    def require_no_signal(self) -> None:
        """Raise `StoppedError` after a signal: no contact may close after the frames of `eldir rig off`."""
        if self._has_signal():
            raise StoppedError("stopped by a signal")

    def _has_signal(self) -> bool:
        return bool(select.select([self._signals], [], [], 0.0)[0])

    def _serve(self) -> None:
        while True:
            wait = self._controller.step() - time.monotonic()
            sources: list[Any] = [self._connection, self._signals]
            ready, _, _ = select.select(sources, [], [], min(max(wait, 0.0), 1.0))
            if self._signals in ready:
                raise self._signal_error()
            if self._connection in ready:
                messages = self._connection.receive()
                if messages is None:
                    raise ParentDiedError("the program that heats has died")
                self._controller.keep_alive()
                for message in messages:
                    if message["command"] == "end_session":
                        self._controller.disarm()
                        if self._controller.armed_once:
                            _save_springs(self._controller, self._rig, self._port)
                        return
                    self._obey(message)

    def _signal_error(self) -> StoppedError:
        number = os.read(self._signals, 64)[0]
        return StoppedError(f"stopped by {signal.Signals(number).name}, such as `eldir rig off` sends")

    def _obey(self, message: dict[str, Any]) -> None:
        match message["command"]:
            case "arm":
                require_unlatched(self._port)
                board = self._rig.board
                self._controller.check_limits()  # before the latch: a refusal is no stop
                latch_for_driving(
                    self._port,
                    board.kind,
                    board.channels,
                    self._rig.name,
                    sensor=self._sensor,
                    sensor_entries=sensor_entries(self._rig),
                )
                self._arm()
                _logger.info("armed: everything is proven off")
                self._connection.send(event="armed", ready_at=self._controller.ready_at)
            case "heat":
                _logger.debug("heat at %s for %s", message["at"], message["durations"])
                try:
                    self._controller.heat(message["at"], {int(c): s for c, s in message["durations"].items()})
                except LimitError as error:
                    self._connection.send(event="refused", reason=str(error), code=error.code)
            case "abort_pulses":
                self._controller.abort_pulses()
            case "keepalive":
                self._connection.send(event="acknowledged")
            case "disarm":
                self._connection.send(event="opening")
                self._controller.disarm()
                end_driving(self._port)
                _logger.info("disarmed: everything is proven off")
                self._connection.send(event="off")
                _save_springs(self._controller, self._rig, self._port)
            case "stop":
                raise StoppedError(message["reason"])

    def _arm(self) -> None:
        try:
            if _keeps_springs(self._rig):
                save_springs(self._port, None)
            self._controller.arm()
        except NotProvenOffError:
            raise
        except EldirError as error:
            if not self._controller.armed_once:  # nothing was heated: after the proof no stop remains
                self._controller.stop(str(error))
                end_driving(self._port)
                _save_springs(self._controller, self._rig, self._port)
            raise

    def _report(self, report: Report) -> None:
        self._connection.send(event="report", report=report)


def _keeps_springs(rig: Rig) -> bool:
    """Whether springs are saved for the next run; those of a virtual rig begin cold."""
    return rig.kind == "real"


def _load_springs(rig: Rig, port: Port) -> Springs | None:
    if not _keeps_springs(rig):
        return None
    found = load_springs(port)
    return springs_at_limit(rig) if found is None else found


def _save_springs(controller: PulseController, rig: Rig, port: Port) -> None:
    """Save the springs after everything was proven off. If that fails they count as hot."""
    if _keeps_springs(rig):
        with suppress(EldirError):
            save_springs(port, controller.export_springs())


def _suspended_time() -> float:
    """Time for which the computer was suspended since it started [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()


def _prepare_for_real_time() -> None:
    """Let no switching wait for the garbage collector or, if this user is permitted, for other programs."""
    gc.collect()
    gc.freeze()
    request_realtime_priority(GUARDIAN)


def serve_parent(connection: GuardianConnection) -> None:
    """Serve one parent to the end, and report the outcome to it, or to the terminal if it has died."""
    select.select([connection], [], [], _START_TIMEOUT)
    messages = connection.receive()
    if not messages:
        return
    run = _Run(connection, messages[0])
    _prepare_for_real_time()
    try:
        run.drive()
    except EldirError as error:
        run.report_error(error)


class _Run:
    """The run of one parent: its rig, devices and pulse controller."""

    def __init__(self, connection: GuardianConnection, configuration: dict[str, Any]):
        self._connection = connection
        self._rig = Rig.from_json(configuration["rig"])
        self._port: Port = configuration["port"]
        self._given_name: str = configuration["given_name"]
        self._sensor_port: str | None = configuration.get("sensor_port")
        self._controller: PulseController | None = None
        self._board: BoardIdentity | None = None

    def drive(self) -> None:
        """Open the devices and serve the parent. Raises `EldirError` at any other end than the parent's."""
        rig = self._rig
        clock = WallClock(EMULATED_PATIENCE) if rig.kind == "virtual" else WallClock()
        with (
            open_board(rig, clock, self._port) as board,
            open_sensor(rig, clock, self._sensor_port) as sensor,
        ):
            self._board = identity = identify_open(board.file_descriptor, self._given_name)
            sensor_identity = None
            if sensor is not None:
                sensor_identity = identify_open(sensor.file_descriptor, self._sensor_port or "")
            self._controller = controller = PulseController(
                board,
                rig,
                clock,
                sensor,
                _load_springs(rig, identity),
                Host(_suspended_time, partial(require_not_stopped, identity)),
            )
            devices = {"device": identity.to_json(), "sensor": sensor_identity and sensor_identity.to_json()}
            self._connection.send(event="ready", process=os.getpid(), **devices)
            try:
                session = _Session(self._connection, controller, rig, identity, sensor_identity)
                board.before_closing = session.require_no_signal
                session.run()
            except BaseException as error:
                self._connection.send(event="opening")
                _stop(controller, identity, error)
                _logger.info("stopped, %s: %s", controller.proof or "not proven off", error)
                raise

    def report_error(self, error: EldirError) -> None:
        """Report the error and what was proven to the parent, or to the terminal if it has died."""
        controller, is_proven = self._controller, not isinstance(error, NotProvenOffError)
        reason, proof = str(error), None
        has_heated = controller is not None and controller.armed_once
        if controller is not None and is_proven:
            proof = controller.proof
        if proof is not None and has_heated:
            reason += f"; {proof}"
        if (
            self._board is not None
            and has_heated
            and (remark := describe_move(self._given_name, self._board))
        ):
            reason += f"; {remark}"
        kind = {"kind": type(error).__name__, "code": error.code}
        was_received = self._connection.send(event="stopped", reason=reason, proof=proof, **kind)
        if controller is not None and has_heated and is_proven:
            _save_springs(controller, self._rig, self._board or self._port)
        if not was_received or isinstance(error.__cause__, KeepaliveError):  # nobody else reports it
            # At the end, as the terminal may block.
            print_line(f"{self._given_name}: {reason}", hazard=not is_proven)


def _stop(controller: PulseController, port: Port, error: BaseException) -> None:
    """Switch everything off, then latch the stop."""
    reason, opened = describe_reason(error), False
    if isinstance(error, NotProvenOffError) and not isinstance(error, CurrentFlowsError):
        latch(port, reason)
        return
    try:
        controller.stop(reason)
        opened = True
    except EldirError as failure:
        if isinstance(error, CurrentFlowsError) and isinstance(failure, CurrentFlowsError):
            return  # which ended the run
        hazard = failure
        if not isinstance(failure, NotProvenOffError):
            problem = f"not proven that everything is off: {failure}"
            hazard = NotProvenOffError(problem, remedy="cut the heating supply now")
        reason = f"{hazard}; it was stopped because: {reason}"  # the hazard comes first
        raise type(hazard)(reason) from error
    finally:
        if controller.armed_once or isinstance(error, CurrentFlowsError):
            latch(port, reason, opened=opened)


def main() -> None:
    """Run the process. Its second argument is the file descriptor of its socket."""
    program_log.configure("guardian")
    with suppress(BrokenPipeError):
        serve_parent(GuardianConnection(socket.socket(fileno=int(sys.argv[2]))))
