"""The client of the guardian: it starts the process, announces pulses and sends heartbeats.

with Guardian(rig) as bank, bank.armed():
    bank.heat(time.monotonic() + 0.5, {1: 3.0})
    bank.rest_until(time.monotonic() + 5.0, print)
"""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from typing import Any

from eldir.errors import EldirError, InputError
from hardware.guardian.bank import Bank, Report, See
from hardware.guardian.wire import Wire
from hardware.relay import errors
from hardware.resource import Resource
from hardware.rig.boards import open_board
from hardware.rig.configuration import Rig
from hardware.rig.port_lock import port_lock
from hardware.rig.supply import LimitError
from hardware.safety.latch import LatchedError, latch

BEAT = 0.1
"""Interval of the heartbeats [s]."""
_STARTING = 20.0  # until the process must have opened the port; on a machine that is busy [s]
_ANSWERING = 10.0  # until everything must have been proven off [s]
_SILENT = 1.5  # while armed it reports twice a second at least [s]
_KINDS = {
    k.__name__: k
    for k in (
        LimitError,
        LatchedError,
        errors.PortError,
        errors.SilentBoardError,
        errors.GarbledReplyError,
        errors.ContactError,
        errors.NotProvenOffError,
    )
}


def _ignore(report: Report) -> None:
    """The default: ignore reports."""


class Guardian(Bank, Resource):
    """The process and its port live between `open` and `close`, or in a `with`.

    Times are those of `time.monotonic`.
    """

    def __init__(self, rig: Rig, port: str | None = None):
        """`port` replaces the rig file's, such as that of an emulated board."""
        self._port = port or rig.board.port or ""
        if not self._port:
            raise InputError("the rig file names no port", remedy="set board.port")
        self._rig = rig
        self._see: See = _ignore
        self._armed = self._ended = False
        self._heard = 0.0
        self.process = 0
        """Process number of the guardian."""

    def open(self) -> None:
        """Start the process and wait until it has opened the port. Raises `EldirError` where it cannot."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._child = subprocess.Popen(
                # -P: a module in the working directory, such as a serial.py beside the rig file, is not run.
                [sys.executable, "-P", "-m", "hardware.guardian.process", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                # Boards of packages that only this program finds, such as in its script's folder.
                env=os.environ | {"PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path)},
                start_new_session=True,  # this process handles Ctrl-C and a closed terminal
            )
        self._wire = Wire(ours)
        self._wire.send(rig=self._rig.model_dump(mode="json"), port=self._port)
        try:
            self.process = self._await("ready", _STARTING)["process"]
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Ask the process to switch everything off and end; it is killed where it does not."""
        self._wire.send(do="end")
        self._wire.close()
        try:
            self._child.wait(_ANSWERING)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()

    def arm(self) -> None:
        self._wire.send(do="arm")
        self._await("armed", _ANSWERING)
        self._armed, self._heard = True, time.monotonic()

    def heat(self, at: float, lengths: Mapping[int, float]) -> None:
        self._wire.send(do="heat", at=at, **{"for": dict(lengths)})

    def cut(self) -> None:
        self._wire.send(do="cut")

    def beat(self, see: See) -> None:
        """Send one heartbeat, pass new reports to `see`. Raises `EldirError` when the guardian has stopped.

        A program with a loop of its own must call this every `BEAT`.
        """
        self._see = see
        self._wire.send(do="beat")
        self._take()
        if self._armed and time.monotonic() - self._heard > _SILENT:
            self._child.kill()
            raise self._vanished("hung")

    def rest_until(self, t: float, see: See) -> None:
        while True:
            self.beat(see)
            left = t - time.monotonic()
            if left <= 0:
                return
            select.select([self._wire], [], [], min(left, BEAT))

    def disarm(self) -> None:
        self._wire.send(do="disarm")
        self._await("off", _ANSWERING)
        self._armed = False

    def stop(self, why: str) -> None:
        if not self._ended:
            self._wire.send(do="stop", why=why)
            try:
                self._await("stopped", _ANSWERING)
            except errors.NotProvenOffError:
                raise
            except EldirError:  # the reason that we sent, sent back
                pass

    def _await(self, wanted: str, patience: float) -> dict[str, Any]:
        deadline = time.monotonic() + patience
        while True:
            for message in self._take():
                if message["is"] == wanted:
                    return message
            left = deadline - time.monotonic()
            if left <= 0:
                raise errors.NotProvenOffError(
                    "the guardian does not answer", remedy="cut the heating supply now"
                )
            self._wire.send(do="beat")
            select.select([self._wire], [], [], min(left, BEAT))

    def _take(self) -> list[dict[str, Any]]:
        """Pass reports on, raise errors, and return the other messages."""
        messages = self._wire.receive()
        if messages is None:
            raise self._vanished("died")
        if messages:
            self._heard = time.monotonic()
        rest = []
        for message in messages:
            match message["is"]:
                case "report":
                    t, closed, temperatures, hottest, latest = message["report"]
                    self._see(Report(t, tuple(closed), tuple(temperatures), hottest, latest))
                case "stopping":
                    self._heard += _ANSWERING
                case "refused":
                    raise LimitError(message["why"])
                case "stopped":
                    self._ended = True
                    raise _KINDS.get(message["kind"], EldirError)(message["why"])
                case _:
                    rest.append(message)
        return rest

    def _vanished(self, how: str) -> EldirError:
        """The guardian is gone: latch the stop and open the contacts from here."""
        self._ended = True
        self._child.wait(_ANSWERING)
        if not self._armed:
            return EldirError("the guardian ended before it was armed", remedy="see its message above")
        latch(self._port, f"the guardian {how}")
        try:
            with port_lock(self._port), open_board(self._rig, port=self._port) as board:
                board.all_off()
        except EldirError as error:
            return errors.NotProvenOffError(
                f"the guardian {how}, and the contacts cannot be opened: {error}",
                remedy="cut the heating supply now",
            )
        return EldirError(f"the guardian {how}; all contacts are open by the board's report")
