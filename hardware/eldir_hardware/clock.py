"""Clocks: the wall clock, and a virtual clock on which five cycles take seconds."""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable
from itertools import count
from typing import Protocol

_LONGEST_NAP = 0.05  # [s]; so that a signal's handler runs soon
EMULATED_PATIENCE = 0.4
"""How long to wait for an emulated board beyond the time on the wire [s]: a busy computer delays it too.

Less than the 0.6 s after which a guardian that waits counts as hung itself.
"""


class Clock(Protocol):
    """A clock that never runs backwards."""

    patience: float
    """How long to wait for an answer beyond its time on the wire, in seconds of real time."""

    def now(self) -> float:
        """Time since an arbitrary start [s]."""

    def sleep_until(self, t: float) -> None:
        """Wait until `t`; return at once if it has passed."""

    def meet(self, t: float) -> None:
        """Wait until exactly `t`, which must be near: this is a busy wait."""

    def at(self, t: float, action: Callable[[float], None]) -> None:
        """Call `action(t)` when time reaches `t`, in some thread."""

    def follower(self) -> Clock:
        """The same time for a user that must not delay it, such as an emulated board."""


class WallClock:
    """The monotonic clock of this machine."""

    def __init__(self, patience: float = 0.2):
        """`patience`: see `Clock`."""
        self.patience = patience

    def now(self) -> float:
        return time.monotonic()

    def sleep_until(self, t: float) -> None:
        while (left := t - time.monotonic()) > 0:
            time.sleep(min(left, _LONGEST_NAP))

    def meet(self, t: float) -> None:
        while time.monotonic() < t:
            pass

    def at(self, t: float, action: Callable[[float], None]) -> None:
        timer = threading.Timer(t - time.monotonic(), action, [t])
        timer.daemon = True
        timer.start()

    def follower(self) -> WallClock:
        return self


class VirtualClock:
    """Moves only when its one leader sleeps. Actions that are due on the way run then, in order of time."""

    patience = 1.0  # costs no virtual time, and a busy machine must not look like a dead board

    def __init__(self) -> None:
        self._now = 0.0
        self._due: list[tuple[float, int, Callable[[float], None]]] = []
        self._tie = count()
        self._barriers: list[Callable[[], None]] = []

    def now(self) -> float:
        return self._now

    def at(self, t: float, action: Callable[[float], None]) -> None:
        """Call `action(t)` when time reaches `t`, in the leader's thread."""
        heapq.heappush(self._due, (max(t, self._now), next(self._tie), action))

    def before_moving(self, barrier: Callable[[], None]) -> None:
        """Wait for `barrier()` each time before time moves, such as until bytes have arrived."""
        self._barriers.append(barrier)

    def sleep_until(self, t: float) -> None:
        for barrier in self._barriers:
            barrier()
        while self._due and self._due[0][0] <= t:
            when, _, action = heapq.heappop(self._due)
            self._now = max(self._now, when)
            action(when)
        self._now = max(self._now, t)

    def meet(self, t: float) -> None:
        self.sleep_until(t)

    def follower(self) -> Clock:
        return _Follower(self)


class _Follower:
    patience = VirtualClock.patience

    def __init__(self, leader: VirtualClock):
        self._leader = leader

    def now(self) -> float:
        return self._leader.now()

    def sleep_until(self, t: float) -> None:
        """Does not wait: the leader alone moves a virtual clock."""

    def meet(self, t: float) -> None:
        """Does not wait either."""

    def at(self, t: float, action: Callable[[float], None]) -> None:
        self._leader.at(t, action)

    def follower(self) -> Clock:
        return self
