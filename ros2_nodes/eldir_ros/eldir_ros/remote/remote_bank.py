# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The springs behind the relay board node, as a `HeaterBank` for the toolkit's player."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping
from typing import Protocol

from eldir.errors import EldirError
from eldir_hardware.guardian.bank import HeaterBank, Report, ReportCallback
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.safety.stop_signals import StoppedError
from eldir_ros.conversions import runs
from eldir_ros.conversions.board import BoardState

_BOARD_PATIENCE = 1.2  # without a report for so long, the board node counts as dead [s]
_BEAT = 0.1  # from one BEAT to the next [s]
_PROVING = 3.0  # until every contact must have been reported open [s]


class InterruptedRunError(EldirError):
    """The run was ended by a message or a fault; `outcome` as in RunSchedule.action."""

    code = "run.interrupted"

    def __init__(self, outcome: int, why: str):
        self.outcome = outcome
        super().__init__(why, remedy="everything was switched off")


class BoardLink(Protocol):
    """Sends commands to the relay board node."""

    def send_command(self, command: int, number: int) -> None:
        """Send BEAT, CUT or END; `number` counts the commands of the run."""

    def send_pulses(self, delay: float, lengths: Mapping[int, float], number: int) -> None:
        """Send pulses that begin after `delay` [s]: channel to seconds."""


BEAT, PULSES, CUT, END = range(4)


class RemoteBank(HeaterBank):
    """Use it from one thread; `report` and `interrupt` may be called from any.

    `run` names the run to the board. `missing` returns the required nodes that are not active; `stopped`
    returns why the emergency stop is latched, or an empty text. Nothing here compares times of two computers.
    """

    def __init__(
        self,
        link: BoardLink,
        run: str,
        missing: Callable[[], tuple[str, ...]],
        stopped: Callable[[], str],
    ):
        self._link, self._run, self._missing, self._stopped = link, run, missing, stopped
        self._sent = 0
        """Number of the latest command."""
        self._reports: queue.Queue[tuple[BoardState, Report] | None] = queue.Queue()
        self._ending: tuple[int, str] | None = None
        self._deciding = threading.Lock()
        self.last: BoardState | None = None
        """The latest report that the run has seen."""
        self._heard = -float("inf")
        self._see: ReportCallback = lambda report: None

    def report(self, state: BoardState) -> None:
        """Add a report that the board node published; call it when the message arrives."""
        t = time.monotonic() - max(state.age, 0.0)
        report = Report(
            t, state.closed, state.temperatures, state.hottest, state.latest, state.currents, state.voltages
        )
        self._reports.put((state, report))

    def interrupt(self, outcome: int, why: str) -> None:
        """End the run at once; only the first reason counts."""
        with self._deciding:
            self._ending = self._ending or (outcome, why)
        self._reports.put(None)

    def arm(self) -> None:
        """Require that the board node is armed, by its reports, and that no required node is missing.

        What is late is awaited for a moment. Activating the board node arms it."""
        deadline = time.monotonic() + _BOARD_PATIENCE
        while not self._is_reported() or self._missing():  # nothing heats yet: what is late may come
            self._take(0.1, lambda report: None)
            self._raise_if_ended()
            if time.monotonic() > deadline:
                break
        if self.last is None or not self._is_reported():
            raise EldirError(
                "the relay board is not armed",
                expected="reports on relay_board/states",
                found="none",
                remedy="ros2 lifecycle set /relay_board configure, then activate",
            )
        if not self.last.armed:
            raise EldirError(
                "the relay board is not armed", remedy="ros2 lifecycle set /relay_board activate"
            )
        if any(self.last.closed):
            raise EldirError("a contact is closed before the start", remedy="look at the relay board")
        self._raise_if_missing()
        self._send(BEAT)

    def heat(self, at: float, lengths: Mapping[int, float]) -> None:
        self._sent += 1
        self._link.send_pulses(at - time.monotonic(), lengths, self._sent)

    def abort_pulses(self) -> None:
        self._send(CUT)

    def wait_until(self, t: float, on_report: ReportCallback) -> None:
        self._see = on_report  # the observer also sees how the run ends
        while True:
            self._send(BEAT)
            left = t - time.monotonic()
            self._take(min(max(left, 0.0), _BEAT), on_report)
            self._raise_if_ended()
            self._raise_if_missing()
            if time.monotonic() - self._heard > _BOARD_PATIENCE:
                raise InterruptedRunError(runs.STOPPED, "the relay board sends no reports any more")
            if left <= 0:
                return

    def disarm(self) -> None:
        """Everything off, proven, at the end of a run; the board node stays armed."""
        self._send(END)
        self._prove_off(self._sent)

    def stop(self, why: str) -> None:
        """Everything off, proven. The board node itself latches the stop where it must: when commands stay
        away, or when the emergency stop is called."""
        self._send(CUT)
        cut = self._sent
        self._send(END)
        self._prove_off(cut, f"{why}; ")

    def _is_reported(self) -> bool:
        """Whether the board node has reported just now."""
        return self.last is not None and time.monotonic() - self._heard <= _BOARD_PATIENCE

    def _send(self, command: int) -> None:
        self._sent += 1
        self._link.send_command(command, self._sent)

    def _prove_off(self, number: int, why: str = "") -> None:
        """Wait for a report that all contacts are open: one read after the board has obeyed the command of
        that number, or by a board that is disarmed, which cannot close any. The observer sees them all, so
        that it knows every edge."""
        deadline = time.monotonic() + _PROVING
        while time.monotonic() < deadline:
            self._take(0.1, self._see)
            last = self.last
            if last is None or any(last.closed):
                continue
            if not last.armed or (last.run == self._run and last.command >= number):
                return
        raise NotProvenOffError(
            f"{why}the relay board did not report that everything is off",
            remedy="cut the heating supply now",
        )

    def _take(self, patience: float, on_report: ReportCallback) -> None:
        """Show the reports that have come; wait up to `patience` [s] for the first one."""
        try:
            item = self._reports.get(timeout=max(patience, 1e-3))
            while True:
                if item is not None:
                    self.last, report = item
                    self._heard = time.monotonic()
                    on_report(report)
                item = self._reports.get_nowait()
        except queue.Empty:
            pass

    def _raise_if_ended(self) -> None:
        if self._stopped():
            raise StoppedError(self._stopped())
        if self._ending is not None:
            raise InterruptedRunError(*self._ending)

    def _raise_if_missing(self) -> None:
        missing = self._missing()
        if missing:
            raise InterruptedRunError(runs.STOPPED, "; ".join(missing))
