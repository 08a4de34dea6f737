"""The client of the guardian: starts its process, announces pulses and sends keepalive messages.

with Guardian(rig) as bank, bank.armed():
    bank.heat(time.monotonic() + 0.5, {1: 3.0})
    bank.wait_until(time.monotonic() + 5.0, print)
"""

from __future__ import annotations

import logging
import os
import select
import signal
import socket
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from eldir.errors import EldirError, InputError
from eldir_hardware._serial_output import BITS_PER_BYTE
from eldir_hardware.current_sensor import SensorError
from eldir_hardware.guardian._connection import (
    MAX_MESSAGE,
    GuardianConnection,
    clean_environment,
    guardian_command,
)
from eldir_hardware.guardian.bank import BOARD_PROOF, HeaterBank, Report, ReportCallback, ignore_report
from eldir_hardware.guardian.measured_heat import (
    CurrentFlowsError,
    UnexpectedHeatError,
    require_no_current,
    supplied_channels,
)
from eldir_hardware.relay import errors
from eldir_hardware.resource import Resource
from eldir_hardware.rig.board_identity import BoardIdentity, describe_move, locate
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import open_board
from eldir_hardware.rig.port_holder import find_holder
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import LatchedError, latch, read_stop
from eldir_hardware.safety.off_frames import UnlockedPort, off_bursts
from eldir_hardware.safety.stop_signals import StoppedError

_logger = logging.getLogger(__name__)
KEEPALIVE_INTERVAL = 0.1
"""Interval of the keepalive messages [s]."""
_START_TIMEOUT = 20.0  # until the process has opened the port, also on a busy computer [s]
_PROOF_TIMEOUT = 10.0  # until everything has been proven off [s]
_PORT_TIMEOUT = 3.0  # until another program, which opens the contacts, has closed the port [s]
_MAX_SILENCE = 0.6  # while armed it answers every keepalive message [s]
_EXIT_TIMEOUT = 2.0  # until a killed process has ended [s]
_ERRORS = {
    k.__name__: k
    for k in (
        LimitError,
        LatchedError,
        errors.PortError,
        errors.BlockedPortError,
        errors.SilentBoardError,
        errors.GarbledReplyError,
        errors.ContactError,
        errors.NotProvenOffError,
        SensorError,
        CurrentFlowsError,
        UnexpectedHeatError,
    )
}


def _parse_report(values: list[Any]) -> Report:
    return Report._make(tuple(value) if isinstance(value, list) else value for value in values)


class Guardian(HeaterBank, Resource):
    """A guardian process with its port, between `open` and `close` or in a `with`.

    Times are those of `time.monotonic`.
    """

    def __init__(self, rig: Rig, port: str | None = None, sensor_port: str | None = None):
        """`port`, `sensor_port`: instead of the rig file's, such as those of emulators."""
        sensor_port = sensor_port or (rig.sensor.port if rig.sensor else None)
        self._sensor_port = sensor_port and os.path.abspath(sensor_port)
        self._port = os.path.abspath(port or rig.require_port())
        self._rig = rig
        self._on_report: ReportCallback = ignore_report
        self._armed = self._has_ended = False
        self._answer_due = self._checked_at = 0.0
        self._supplied: set[int] = set()  # channels in which current was measured in this run
        self.process = 0
        """Process number of the guardian."""
        self._board_identity: BoardIdentity
        """The board of the run, whatever board its port names later."""
        self._sensor_identity: BoardIdentity | None = None

    def open(self) -> None:
        """Start the process and wait until it has opened the port. Raises `EldirError` if it cannot."""
        device = os.path.realpath(self._port)
        configuration = {
            "rig": self._rig.to_json(),
            "port": device,
            "given_name": self._port,
            "sensor_port": self._sensor_port,
        }
        if not GuardianConnection.fits(**configuration):
            raise InputError(
                "the rig file is too large for the guardian",
                code="rig.too-large",
                expected=f"at most {MAX_MESSAGE >> 10} KiB as JSON",
                remedy="shorten the texts in it",
            )
        own_end, guardian_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with guardian_end:
            board = self._rig.board
            self._process = subprocess.Popen(
                guardian_command(guardian_end.fileno(), device, board.kind, board.channels, self._port),
                pass_fds=[guardian_end.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=clean_environment(),
                cwd="/",
                start_new_session=True,  # this process handles Ctrl-C and a closed terminal
            )
        self._connection = GuardianConnection(own_end)
        self._connection.send(**configuration)
        try:
            ready = self._wait_for("ready", _START_TIMEOUT)
        except BaseException:
            self.close()
            raise
        self.process = ready["process"]
        self._board_identity = BoardIdentity.from_json(ready["device"], self._port)
        _logger.info("guardian %d holds %s", self.process, self._port)
        self._sensor_identity = ready["sensor"] and BoardIdentity.from_json(
            ready["sensor"], self._sensor_port or ""
        )

    def close(self) -> None:
        """Let the process switch everything off and end; it is killed if it does not end."""
        self._connection.send(command="end_session")
        self._connection.close()
        with suppress(subprocess.TimeoutExpired):
            status = self._process.wait(_EXIT_TIMEOUT if self._has_ended else _PROOF_TIMEOUT)
            _logger.info("guardian %d ended with status %d", self._process.pid, status)
            return
        self._process.kill()
        with suppress(subprocess.TimeoutExpired):  # the kernel holds it
            self._process.wait(_EXIT_TIMEOUT)

    def arm(self) -> None:
        self._supplied = set()
        self._connection.send(command="arm")
        self.ready_at = self._wait_for("armed", _PROOF_TIMEOUT)["ready_at"]
        self._armed, self._answer_due = True, time.monotonic() + _MAX_SILENCE

    def heat(self, at: float, durations: Mapping[int, float]) -> None:
        self._connection.send(command="heat", at=at, durations=dict(durations))

    def abort_pulses(self) -> None:
        self._connection.send(command="abort_pulses")

    def keep_alive(self, on_report: ReportCallback = ignore_report) -> None:
        """Send a keepalive message, and pass new reports to `on_report`. Raises `EldirError`.

        A program with its own loop must call this every `KEEPALIVE_INTERVAL`.
        """
        self._on_report = on_report
        self._connection.send(command="keepalive")
        self._receive()
        self._require_answers()

    def wait_until(self, t: float, on_report: ReportCallback = ignore_report) -> None:
        while True:
            self.keep_alive(on_report)
            left = t - time.monotonic()
            if left <= 0:
                return
            select.select([self._connection], [], [], min(left, KEEPALIVE_INTERVAL))

    def disarm(self) -> None:
        self._connection.send(command="disarm")
        self._wait_for("off", _PROOF_TIMEOUT)
        self._armed = False

    def stop(self, reason: str) -> None:
        if not self._has_ended:
            self._connection.send(command="stop", reason=reason)
        while not self._has_ended:
            try:
                self._wait_for("stopped", _PROOF_TIMEOUT)
            except errors.NotProvenOffError:
                raise
            except EldirError:  # our own reason, returned; or a pulse that was refused earlier
                pass

    def _wait_for(self, wanted: str, patience: float) -> dict[str, Any]:
        deadline = time.monotonic() + patience
        while True:
            for message in self._receive():
                if message["event"] == wanted:
                    return message
            self._require_answers()
            left = deadline - time.monotonic()
            if left <= 0:
                raise errors.NotProvenOffError(
                    "the guardian does not answer", remedy="cut the heating supply now"
                )
            self._connection.send(command="keepalive")
            select.select([self._connection], [], [], min(left, KEEPALIVE_INTERVAL))

    def _require_answers(self) -> None:
        """Raise if the guardian hangs while it may heat; then this process opens the contacts."""
        now, checked_at = time.monotonic(), self._checked_at
        self._checked_at = now
        if not self._armed or now <= self._answer_due:
            return
        # This process itself was suspended: wait once more.
        if checked_at < self._answer_due - _MAX_SILENCE / 2:
            self._answer_due = now + _MAX_SILENCE / 2
            return
        self._process.kill()
        raise self._handle_loss("hung")

    def _receive(self) -> list[dict[str, Any]]:
        """Pass reports on, raise errors, and return the other messages."""
        messages = self._connection.receive()
        if messages is None:
            raise self._handle_loss("died")
        if messages:  # none takes away the time in which it may write its state to a busy disk
            self._answer_due = max(self._answer_due, time.monotonic() + _MAX_SILENCE)
        reports: list[Report] = []
        others: list[dict[str, Any]] = []
        problem: EldirError | None = None
        for message in messages:
            match message["event"]:
                case "report":
                    reports.append(_parse_report(message["report"]))
                    self._note_supply(reports[-1])
                case "opening":  # contacts, proving and saving it, which takes longer than a keepalive
                    self._answer_due = time.monotonic() + _MAX_SILENCE + _PROOF_TIMEOUT
                case "refused":
                    problem = problem or LimitError(message["reason"], code=message.get("code"))
                case "stopped":
                    problem = self._end_by(message)
                case "acknowledged":
                    pass
                case _:
                    others.append(message)
        try:
            for report in reports:
                self._on_report(report)
        finally:
            if problem is not None:  # more important than an error of a callback
                raise problem
        return others

    def _end_by(self, message: dict[str, Any]) -> EldirError:
        """Note that the guardian has stopped, and return its error."""
        self._has_ended = True
        self.proof = message["proof"]
        error = _ERRORS.get(message["kind"], EldirError)
        return error(message["reason"], code=message.get("code"))

    def _note_supply(self, report: Report) -> None:
        in_order = [c.channel for c in self._rig.channels]
        currents = dict(zip(in_order, report.currents, strict=False))
        self._supplied |= supplied_channels(self._rig, report.closed, currents)

    def _handle_loss(self, cause: str) -> EldirError:
        """After the loss of the guardian, open the contacts and latch the stop; return the error.

        A signal may interrupt this anywhere; then `stop` does it again.
        """
        if not self._armed:
            status = 0
            with suppress(subprocess.TimeoutExpired):
                status = self._process.wait(_EXIT_TIMEOUT)
            self._has_ended = True
            problem = "the guardian ended before it was armed"
            if status < 0:  # a signal, such as that of `eldir rig off`: it could not say anything
                problem += f", by {signal.Signals(-status).name}"
            return EldirError(
                problem,
                code="guardian.not-armed",
                remedy="start again" if status < 0 else "see its message above",
            )
        if locate(self._board_identity) is None:
            cause += f", and the port {self._port} was lost"
        elif remark := describe_move(self._port, self._board_identity):
            cause += f" ({remark})"
        try:
            self._open_contacts()
        except StoppedError:  # a signal; `stop` continues
            raise
        except EldirError as error:
            failure: EldirError | None = error
        else:
            failure = None
        latch(self._board_identity, f"the guardian {cause}", opened=failure is None)
        with suppress(EldirError):  # killed by `eldir rig off`: its reason was latched first
            if (reason := read_stop(self._board_identity)) and reason != f"the guardian {cause}":
                cause += f" ({reason})"
        outcome = self._loss_error(cause, failure)
        self._has_ended = True
        return outcome

    def _loss_error(self, cause: str, failure: EldirError | None) -> EldirError:
        """The error to raise, after the contacts were opened or `failure` prevented it."""
        if failure is not None:
            return errors.NotProvenOffError(
                f"the guardian {cause}, and the contacts cannot be opened: {failure}",
                remedy="cut the heating supply now",
            )
        self.proof = BOARD_PROOF
        statement = f"the guardian {cause}; {self.proof}"
        try:
            proof = require_no_current(self._rig, self._sensor_identity, supplied=self._supplied)
        except CurrentFlowsError as flows:
            return CurrentFlowsError(f"{flows}; the guardian {cause}")
        except StoppedError:
            raise
        except EldirError as error:
            return EldirError(f"{statement}, but not proven by the sensor: {error}", code="guardian.gone")
        return EldirError(statement + (f"; {proof}" if proof else ""), code="guardian.gone")

    def _open_contacts(self) -> None:
        """Open the contacts without the guardian, at once or after `eldir rig off` has used the port.

        The frames are sent before any wait: the kernel may delay the end of a killed guardian, and the
        release of its lock. Raises `EldirError` if the board does not confirm it.
        """
        with suppress(OSError):
            self._send_off_frames()
        try:
            self._process.wait(_EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            raise errors.PortError(
                "the guardian's process does not end, and holds the port", remedy="look at the contacts"
            ) from None
        deadline = time.monotonic() + _PORT_TIMEOUT
        while True:
            try:
                with open_board(self._rig, port=self._board_identity) as board:
                    board.all_off()
                return
            except errors.NotProvenOffError:
                raise
            except errors.PortError:
                if time.monotonic() > deadline or find_holder(self._board_identity) is None:
                    raise
                time.sleep(0.02)

    def _send_off_frames(self) -> None:
        """Write without the port's lock and wait for the answers without reading them. Raises `OSError`."""
        port = UnlockedPort(self._board_identity)
        try:
            for frames, baud in off_bursts([(self._rig.board.kind, self._rig.board.channels)]):
                port.send(frames, baud, is_held=not port.is_free())
                time.sleep(2 * len(frames) * BITS_PER_BYTE / baud)
        finally:
            port.close()
