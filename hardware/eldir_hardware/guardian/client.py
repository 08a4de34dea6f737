"""The client of the guardian: it starts the process, announces pulses and sends heartbeats.

with Guardian(rig) as bank, bank.armed():
    bank.heat(time.monotonic() + 0.5, {1: 3.0})
    bank.wait_until(time.monotonic() + 5.0, print)
"""

from __future__ import annotations

import logging
import os
import select
import socket
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from eldir.errors import EldirError, InputError
from eldir_hardware.guardian.bank import BY_THE_BOARD, HeaterBank, Report, ReportCallback
from eldir_hardware.guardian.isolation import clean_environment, guardian_command
from eldir_hardware.guardian.measured_heat import (
    CurrentFlowsError,
    WrongHeatError,
    require_no_current,
    supplied_channels,
)
from eldir_hardware.guardian.wire import LARGEST, Wire
from eldir_hardware.relay import errors
from eldir_hardware.relay.off_frames import off_bursts
from eldir_hardware.resource import Resource
from eldir_hardware.rig.board_identity import BoardIdentity, locate, moved
from eldir_hardware.rig.boards import open_board
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.port_holder import holder_of
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import LatchedError, latch, stop_of
from eldir_hardware.safety.stop_signals import StoppedError
from eldir_hardware.safety.unlocked_port import UnlockedPort
from eldir_hardware.sensor.errors import SensorError
from eldir_hardware.serial_output import BITS_A_BYTE

_logger = logging.getLogger(__name__)
HEARTBEAT_INTERVAL = 0.1
"""Interval of the heartbeats [s]."""
_STARTING = 20.0  # until the process must have opened the port; on a machine that is busy [s]
_ANSWERING = 10.0  # until everything must have been proven off [s]
_OTHERS = 3.0  # until another program, which opens the contacts, has left the port [s]
_SILENT = 0.6  # while armed it answers every heartbeat [s]
_DYING = 2.0  # until a process that was killed has gone [s]
_KINDS = {
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
        WrongHeatError,
    )
}


def _ignore(report: Report) -> None:
    """The default: ignore reports."""


class Guardian(HeaterBank, Resource):
    """The process and its port live between `open` and `close`, or in a `with`.

    Times are those of `time.monotonic`.
    """

    def __init__(self, rig: Rig, port: str | None = None, sensor_port: str | None = None):
        """The ports replace the rig file's, such as those of an emulated board and current sensor."""
        sensor_port = sensor_port or (rig.sensor.port if rig.sensor else None)
        self._sensor_port = sensor_port and os.path.abspath(sensor_port)
        self._port = os.path.abspath(port or rig.require_port())
        self._rig = rig
        self._see: ReportCallback = _ignore
        self._armed = self._ended = False
        self._due = self._looked = 0.0
        self._supplied: set[int] = set()  # channels in which the sensor has measured current in this run
        self.process = 0
        """Process number of the guardian."""
        self._device: BoardIdentity
        """The board of the run, from its first second. Its name may stand for another one later."""
        self._sensor: BoardIdentity | None = None

    def open(self) -> None:
        """Start the process and wait until it has opened the port. Raises `EldirError` where it cannot."""
        device = os.path.realpath(self._port)
        first = {
            "rig": self._rig.to_json(),
            "port": device,
            "named": self._port,
            "sensor_port": self._sensor_port,
        }
        if not Wire.fits(**first):
            raise InputError(
                "the rig file is too large for the guardian",
                code="rig.too-large",
                expected=f"at most {LARGEST >> 10} KiB as JSON",
                remedy="shorten its texts",
            )
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            board = self._rig.board
            self._child = subprocess.Popen(
                guardian_command(theirs.fileno(), device, board.kind, board.channels, self._port),
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=clean_environment(),
                cwd="/",
                start_new_session=True,  # this process handles Ctrl-C and a closed terminal
            )
        self._wire = Wire(ours)
        self._wire.send(**first)
        try:
            ready = self._await("ready", _STARTING)
        except BaseException:
            self.close()
            raise
        self.process = ready["process"]
        self._device = BoardIdentity.of(ready["device"], self._port)
        _logger.info("guardian %d holds %s", self.process, self._port)
        self._sensor = ready["sensor"] and BoardIdentity.of(ready["sensor"], self._sensor_port or "")

    def close(self) -> None:
        """Ask the process to switch everything off and end; it is killed where it does not."""
        self._wire.send(do="end")
        self._wire.close()
        with suppress(subprocess.TimeoutExpired):
            status = self._child.wait(_DYING if self._ended else _ANSWERING)
            _logger.info("guardian %d ended with status %d", self._child.pid, status)
            return
        self._child.kill()
        with suppress(subprocess.TimeoutExpired):  # the kernel holds it
            self._child.wait(_DYING)

    def arm(self) -> None:
        self._supplied = set()
        self._wire.send(do="arm")
        self.rested_at = self._await("armed", _ANSWERING)["rested_at"]
        self._armed, self._due = True, time.monotonic() + _SILENT

    def heat(self, at: float, lengths: Mapping[int, float]) -> None:
        self._wire.send(do="heat", at=at, **{"for": dict(lengths)})

    def abort_pulses(self) -> None:
        self._wire.send(do="abort_pulses")

    def beat(self, on_report: ReportCallback) -> None:
        """Send one heartbeat, pass new reports to `on_report`. Raises `EldirError` after the guardian's end.

        A program with a loop of its own must call this every `HEARTBEAT_INTERVAL`.
        """
        self._see = on_report
        self._wire.send(do="beat")
        self._take()
        self._require_answers()

    def wait_until(self, t: float, on_report: ReportCallback) -> None:
        while True:
            self.beat(on_report)
            left = t - time.monotonic()
            if left <= 0:
                return
            select.select([self._wire], [], [], min(left, HEARTBEAT_INTERVAL))

    def disarm(self) -> None:
        self._wire.send(do="disarm")
        self._await("off", _ANSWERING)
        self._armed = False

    def stop(self, why: str) -> None:
        if not self._ended:
            self._wire.send(do="stop", why=why)
        while not self._ended:
            try:
                self._await("stopped", _ANSWERING)
            except errors.NotProvenOffError:
                raise
            except EldirError:  # the reason that we sent, sent back; or a pulse refused before it was read
                pass

    def _await(self, wanted: str, patience: float) -> dict[str, Any]:
        deadline = time.monotonic() + patience
        while True:
            for message in self._take():
                if message["is"] == wanted:
                    return message
            self._require_answers()
            left = deadline - time.monotonic()
            if left <= 0:
                raise errors.NotProvenOffError(
                    "the guardian does not answer", remedy="cut the heating supply now"
                )
            self._wire.send(do="beat")
            select.select([self._wire], [], [], min(left, HEARTBEAT_INTERVAL))

    def _require_answers(self) -> None:
        """Raise where the guardian hangs while it may heat; the contacts are opened from here then."""
        now, looked = time.monotonic(), self._looked
        self._looked = now
        if not self._armed or now <= self._due:
            return
        if looked < self._due - _SILENT / 2:  # it is we who stood still: once more, and only once
            self._due = now + _SILENT / 2
            return
        self._child.kill()
        raise self._vanished("hung")

    def _take(self) -> list[dict[str, Any]]:
        """Pass reports on, raise errors, and return the other messages."""
        messages = self._wire.receive()
        if messages is None:
            raise self._vanished("died")
        if messages:
            self._due = time.monotonic() + _SILENT
        rest: list[dict[str, Any]] = []
        reports: list[Report] = []
        problem: EldirError | None = None
        for message in messages:
            match message["is"]:
                case "report":
                    fields = (tuple(f) if isinstance(f, list) else f for f in message["report"])
                    reports.append(Report._make(fields))
                    self._note_supply(reports[-1])
                case "opening":  # and proving it, which takes longer than a heartbeat
                    self._due = time.monotonic() + _SILENT + _ANSWERING
                case "refused":
                    problem = problem or LimitError(message["why"], code=message.get("code"))
                case "stopped":
                    self._ended = True
                    self.proof = message["proof"]
                    kind = _KINDS.get(message["kind"], EldirError)
                    problem = kind(message["why"], code=message.get("code"))
                case "alive":
                    pass
                case _:
                    rest.append(message)
        try:
            for report in reports:
                self._see(report)
        finally:
            if problem is not None:  # how it stopped is worse news than a disk that is full
                raise problem
        return rest

    def _note_supply(self, report: Report) -> None:
        in_order = [c.channel for c in self._rig.channels]
        currents = dict(zip(in_order, report.currents, strict=False))
        self._supplied |= supplied_channels(self._rig, report.closed, currents)

    def _vanished(self, how: str) -> EldirError:
        """The guardian is gone: open the contacts from here, then latch the stop.

        A signal may interrupt this anywhere: it counts as ended only when it is, and `stop` does it again.
        """
        if not self._armed:
            with suppress(subprocess.TimeoutExpired):
                self._child.wait(_DYING)  # it may have something to say
            self._ended = True
            return EldirError(
                "the guardian ended before it was armed",
                code="guardian.not-armed",
                remedy="see its message above",
            )
        if locate(self._device) is None:
            how += f", and the port {self._port} was lost"
        elif elsewhere := moved(self._port, self._device):
            how += f" ({elsewhere})"
        try:
            self._open_contacts()
        except StoppedError:  # a signal; `stop` goes on
            raise
        except EldirError as error:
            failure: EldirError | None = error
        else:
            failure = None
        latch(self._device, f"the guardian {how}", opened=failure is None)
        with suppress(EldirError):  # killed by `eldir rig off`: the first reason stays
            if (reason := stop_of(self._device)) and reason != f"the guardian {how}":
                how += f" ({reason})"
        outcome = self._judged(how, failure)
        self._ended = True
        return outcome

    def _judged(self, how: str, failure: EldirError | None) -> EldirError:
        """The error to raise, after the contacts were opened or could not be."""
        if failure is not None:
            return errors.NotProvenOffError(
                f"the guardian {how}, and the contacts cannot be opened: {failure}",
                remedy="cut the heating supply now",
            )
        self.proof = BY_THE_BOARD
        opened = f"the guardian {how}; {self.proof}"
        try:
            measured = require_no_current(self._rig, self._sensor, supplied=self._supplied)
        except CurrentFlowsError as flows:
            return CurrentFlowsError(f"{flows}; the guardian {how}")
        except StoppedError:
            raise
        except EldirError as error:
            return EldirError(f"{opened}, but not by the sensor's: {error}", code="guardian.gone")
        return EldirError(opened + (f"; {measured}" if measured else ""), code="guardian.gone")

    def _open_contacts(self) -> None:
        """Open the contacts without the guardian, at once or after `eldir rig off` has the port.

        The frames go out before anything is waited for: the kernel may hold a guardian that was killed, and
        its lock with it. Raises `EldirError` where the board does not confirm it.
        """
        with suppress(OSError):
            self._send_off_frames()
        try:
            self._child.wait(_DYING)
        except subprocess.TimeoutExpired:
            raise errors.PortError(
                "its process does not end, and holds the port", remedy="look at the contacts"
            ) from None
        deadline = time.monotonic() + _OTHERS
        while True:
            try:
                with open_board(self._rig, port=self._device) as board:
                    board.all_off()
                return
            except errors.NotProvenOffError:
                raise
            except errors.PortError:
                if time.monotonic() > deadline or holder_of(self._device) is None:
                    raise
                time.sleep(0.02)

    def _send_off_frames(self) -> None:
        """Without the port's lock; answers are waited for and not read. Raises `OSError`."""
        port = UnlockedPort(self._device)
        try:
            for frames, baud in off_bursts([(self._rig.board.kind, self._rig.board.channels)]):
                port.send(frames, baud, held=not port.is_free())
                time.sleep(2 * len(frames) * BITS_A_BYTE / baud)
        finally:
            port.close()
