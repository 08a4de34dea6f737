# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The springs behind the relay board node, as a `HeaterBank` for the toolkit's player, and which of its
commands that node has obeyed."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Protocol

from eldir_msgs.msg import HeatCommand

from eldir.errors import EldirError
from eldir_hardware.guardian.bank import BOARD_PROOF, HeaterBank, Report, ReportCallback, ignore_report
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.safety.stop_signals import StoppedError
from eldir_ros.conversions import runs
from eldir_ros.conversions.board import BoardState

_BOARD_TIMEOUT = 1.2  # without a report for so long, the board node counts as dead [s]
_ARM_TIMEOUT = 5.0  # until the board node must be heard before a run, while nothing heats [s]
_KEEPALIVE_INTERVAL = 0.1  # [s]
_OFF_TIMEOUT = 3.0  # until every contact must have been reported open [s]
_MAX_COMMANDS = 100  # a report is younger than a second, a command comes every 0.1 s


class InterruptedRunError(EldirError):
    """The run was ended by a message or a fault; `outcome` as in RunSchedule.action."""

    code = "run.interrupted"

    def __init__(self, outcome: int, why: str):
        self.outcome = outcome
        super().__init__(why, remedy="everything was switched off")


class BoardLink(Protocol):
    """Sends commands to the relay board node."""

    def send_command(self, command: int, sequence: int) -> None:
        """Send KEEPALIVE, ABORT or END_OF_RUN; `sequence`: number of the command in the run."""

    def send_pulses(self, delay: float, lengths: Mapping[int, float], sequence: int) -> None:
        """Send pulses that begin after `delay` [s]; `lengths`: duration by channel [s]."""


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
        self._sequence = 0
        """Number of the last command."""
        self._reports: queue.Queue[tuple[BoardState, Report] | None] = queue.Queue()
        self._ending: tuple[int, str] | None = None
        self._ending_lock = threading.Lock()
        self.last: BoardState | None = None
        """The last report of the board."""
        self._last_report_at = -float("inf")
        self._on_report: ReportCallback = ignore_report

    def report(self, state: BoardState) -> None:
        """Add a report that the board node published; call it when the message arrives."""
        t = time.monotonic() - max(state.age, 0.0)
        report = Report(
            t,
            state.closed,
            state.temperatures,
            state.peak_temperature,
            state.max_delay,
            state.currents,
            state.voltages,
        )
        self._reports.put((state, report))

    def interrupt(self, outcome: int, why: str) -> None:
        """End the run at once; only the first reason counts."""
        with self._ending_lock:
            self._ending = self._ending or (outcome, why)
        self._reports.put(None)

    def arm(self) -> None:
        """Require that the board node is armed, by its reports, and that no required node is missing.

        Waits up to `_ARM_TIMEOUT` for that: the first report to arrive may be from before the board node was
        activated. Activating the board node arms it."""
        self.proof = None
        deadline = time.monotonic() + _ARM_TIMEOUT
        while not self._is_armed() or self._missing():  # nothing heats yet
            self._take_reports(0.1, ignore_report)
            self._require_running()
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
        self._require_nodes()
        self._send(HeatCommand.KEEPALIVE)

    def reports_all_open(self) -> bool:
        """Whether every contact is open by a report that is read from now on; false where none comes within
        `_BOARD_TIMEOUT`. For a run that was refused: nothing was announced."""
        begun, reports = time.monotonic(), list[Report]()
        while time.monotonic() < begun + _BOARD_TIMEOUT:
            self._take_reports(0.1, reports.append)
            if reports and reports[-1].t >= begun:
                return not any(reports[-1].closed)
        return False

    def heat(self, at: float, durations: Mapping[int, float]) -> None:
        self._sequence += 1
        self._link.send_pulses(at - time.monotonic(), durations, self._sequence)

    def abort_pulses(self) -> None:
        self._send(HeatCommand.ABORT)

    def wait_until(self, t: float, on_report: ReportCallback = ignore_report) -> None:
        self._on_report = on_report  # the observer also gets the reports at the end of the run
        while True:
            self._send(HeatCommand.KEEPALIVE)
            remaining = t - time.monotonic()
            self._take_reports(min(max(remaining, 0.0), _KEEPALIVE_INTERVAL), on_report)
            self._require_running()
            self._require_nodes()
            if time.monotonic() - self._last_report_at > _BOARD_TIMEOUT:
                raise InterruptedRunError(runs.STOPPED, "the relay board sends no reports any more")
            if remaining <= 0:
                return

    def disarm(self) -> None:
        """Everything off, proven, at the end of a run; the board node stays armed."""
        self._send(HeatCommand.END_OF_RUN)
        self._prove_off(self._sequence)

    def stop(self, reason: str) -> None:
        """Everything off, proven. The board node itself latches the stop where it must: when commands fail to
        arrive, or when the emergency stop is called."""
        self._send(HeatCommand.ABORT)
        aborted = self._sequence
        self._send(HeatCommand.END_OF_RUN)
        self._prove_off(aborted, f"{reason}; ")

    def _is_armed(self) -> bool:
        return self.last is not None and self.last.armed and self._is_reported()

    def _is_reported(self) -> bool:
        """Whether the board node has reported within `_BOARD_TIMEOUT`."""
        return self.last is not None and time.monotonic() - self._last_report_at <= _BOARD_TIMEOUT

    def _send(self, command: int) -> None:
        self._sequence += 1
        self._link.send_command(command, self._sequence)

    def _prove_off(self, sequence: int, why: str = "") -> None:
        """Wait for a report that all contacts are open: one that was read after the board obeyed the command
        `sequence`, or one of a board that is disarmed, which cannot close any. The observer gets all reports,
        so that it knows every edge."""
        deadline = time.monotonic() + _OFF_TIMEOUT
        while time.monotonic() < deadline:
            self._take_reports(0.1, self._on_report)
            last = self.last
            if last is None or any(last.closed):
                continue
            if not last.armed or (last.run == self._run and last.sequence >= sequence):
                self.proof = BOARD_PROOF
                return
        raise NotProvenOffError(
            f"{why}the relay board did not report that everything is off",
            remedy="cut the heating supply now",
        )

    def _take_reports(self, timeout: float, on_report: ReportCallback) -> None:
        """Pass the reports that have arrived to `on_report`; wait up to `timeout` [s] for the first one."""
        try:
            item = self._reports.get(timeout=max(timeout, 1e-3))
            while True:
                if item is not None:
                    self.last, report = item
                    self._last_report_at = time.monotonic()
                    on_report(report)
                item = self._reports.get_nowait()
        except queue.Empty:
            pass

    def _require_running(self) -> None:
        if self._stopped():
            raise StoppedError(self._stopped())
        if self._ending is not None:
            raise InterruptedRunError(*self._ending)

    def _require_nodes(self) -> None:
        missing = self._missing()
        if missing:
            raise InterruptedRunError(runs.STOPPED, "; ".join(missing))


class ObeyedCommands:
    """Sequence numbers of commands and when they were obeyed, on the clock of the board's readings [s], so
    that a report can name the latest one before it."""

    def __init__(self) -> None:
        self._obeyed: deque[tuple[float, str, int]] = deque(maxlen=_MAX_COMMANDS)

    def require_new(self, run: str, sequence: int) -> None:
        """Raise `ValueError` for a command that is repeated or late in its run."""
        _, last_run, last = self._obeyed[-1] if self._obeyed else (0.0, "", 0)
        previous = last if run == last_run else 0
        if sequence <= previous:
            raise ValueError(f"its sequence is {sequence}, expected more than {previous}")

    def add(self, run: str, sequence: int, now: float) -> None:
        """Record a command that was obeyed at `now` [s]."""
        self._obeyed.append((now, run, sequence))

    def before(self, t: float) -> tuple[str, int]:
        """Run and sequence of the last command that was obeyed before `t`; 0 if there is none."""
        earlier = [(run, sequence) for at, run, sequence in self._obeyed if at < t]
        return earlier[-1] if earlier else ("", 0)
