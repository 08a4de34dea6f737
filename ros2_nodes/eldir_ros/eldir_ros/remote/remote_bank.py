"""Springs behind the relay board node, as a `Bank` of the toolkit's player: messages in, messages out."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping
from typing import Protocol

from eldir.errors import EldirError
from eldir_ros.conversions import runs
from eldir_ros.conversions.board import BoardState
from hardware.guardian.bank import Bank, Report, See
from hardware.relay.errors import NotProvenOffError
from hardware.safety.stop_signals import StoppedError

_BOARD_PATIENCE = 1.2  # without a report for so long, the board node counts as gone [s]
_BEAT = 0.1  # from one to the next [s]
_PROVING = 3.0  # until every contact must have been reported open [s]


class InterruptedRunError(EldirError):
    """The run was ended from outside; `outcome` as in RunSchedule.action."""

    def __init__(self, outcome: int, why: str):
        self.outcome = outcome
        super().__init__(why, remedy="everything was switched off")


class Line(Protocol):
    """How words reach the relay board node."""

    def tell(self, command: int) -> None:
        """BEAT, CUT or END."""

    def announce(self, at: float, lengths: Mapping[int, float]) -> None:
        """Pulses at `at` on the monotonic clock."""


BEAT, PULSES, CUT, END = range(4)


class RemoteBank(Bank):
    """Use from one thread; `report`, `interrupt` and `latch` may be called from any.

    `missing` tells who of the nodes that a run needs is not there.
    """

    def __init__(self, line: Line, missing: Callable[[], tuple[str, ...]], stopped: Callable[[], str]):
        self._line, self._missing, self._stopped = line, missing, stopped
        self._reports: queue.Queue[tuple[BoardState, Report] | None] = queue.Queue()
        self._ending: tuple[int, str] | None = None
        self._deciding = threading.Lock()
        self.last: BoardState | None = None
        """The latest report that was taken."""
        self._heard = -float("inf")
        self._see: See = lambda report: None

    def report(self, state: BoardState, now_ns: int) -> None:
        """What the board node published."""
        t = time.monotonic() - 1e-9 * (now_ns - state.stamp)
        report = Report(t, state.closed, state.temperatures, state.hottest, state.latest)
        self._reports.put((state, report))

    def interrupt(self, outcome: int, why: str) -> None:
        """End the run, at once; only the first reason counts."""
        with self._deciding:
            self._ending = self._ending or (outcome, why)
        self._reports.put(None)

    def arm(self) -> None:
        """The board node is armed by whoever activates it; here it is only looked at."""
        deadline = time.monotonic() + _BOARD_PATIENCE
        while self.last is None or time.monotonic() - self._heard > _BOARD_PATIENCE:
            self._take(0.1, lambda report: None)
            self._raise_if_ended()
            if time.monotonic() > deadline:
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
        self._line.tell(BEAT)

    def heat(self, at: float, lengths: Mapping[int, float]) -> None:
        self._line.announce(at, lengths)

    def cut(self) -> None:
        self._line.tell(CUT)

    def rest_until(self, t: float, see: See) -> None:
        self._see = see  # whoever watches sees how it ends, too
        while True:
            self._line.tell(BEAT)
            left = t - time.monotonic()
            self._take(min(max(left, 0.0), _BEAT), see)
            self._raise_if_ended()
            self._raise_if_missing()
            if time.monotonic() - self._heard > _BOARD_PATIENCE:
                raise InterruptedRunError(runs.STOPPED, "the relay board reports nothing any more")
            if left <= 0:
                return

    def disarm(self) -> None:
        """The good end: everything off, proven; the board node stays armed."""
        self._line.tell(END)
        self._prove_off()

    def stop(self, why: str) -> None:
        """Everything off, proven. The board node latches where it must: when it hears nothing any more,
        or when the emergency stop is called."""
        self._line.tell(CUT)
        self._line.tell(END)
        if not self._stopped():
            self._prove_off()

    def _prove_off(self) -> None:
        told = time.monotonic()
        while time.monotonic() - told < _PROVING and not self._stopped():
            fresh: list[Report] = []
            self._take(0.1, fresh.append)
            for report in fresh:
                self._see(report)
            if any(r.t > told and not any(r.closed) for r in fresh):
                return
        if not self._stopped():  # else the board node has proven it
            raise NotProvenOffError(
                "the relay board did not report that everything is off", remedy="cut the heating supply now"
            )

    def _take(self, patience: float, see: See) -> None:
        """Show what has been reported; wait for it a while."""
        try:
            item = self._reports.get(timeout=max(patience, 1e-3))
            while True:
                if item is not None:
                    self.last, report = item
                    self._heard = time.monotonic()
                    see(report)
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
