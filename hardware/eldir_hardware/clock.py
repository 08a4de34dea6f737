"""Clocks: the wall clock, and a virtual clock on which five cycles take seconds."""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable
from itertools import count
from typing import Protocol

_MAX_SLEEP = 0.05  # so that signal handlers run soon [s]
EMULATED_PATIENCE = 0.4
"""Extra time for the answer of an emulated board, which a busy computer delays [s].

It is less than the 0.6 s after which a waiting guardian counts as hung.
"""


class Clock(Protocol):
    """A clock that never runs backwards."""

    patience: float
    """Extra time for an answer, beyond its time on the wire [s of real time]."""

    def now(self) -> float:
        """Time since an arbitrary start [s]."""

    def sleep_until(self, t: float) -> None:
        """Wait until `t`; return at once if it has passed."""

    def spin_until(self, t: float) -> None:
        """Wait until exactly `t` in a busy loop; `t` must be near."""

    def call_at(self, t: float, action: Callable[[float], None]) -> None:
        """Call `action(t)` when time reaches `t`, in another thread."""

    def follower(self) -> Clock:
        """The same clock for a user that must not move it, such as an emulated board."""


class WallClock:
    """The monotonic clock of this machine."""

    def __init__(self, patience: float = 0.2):
        """`patience`: see `Clock`."""
        self.patience = patience

    def now(self) -> float:
        return time.monotonic()

    def sleep_until(self, t: float) -> None:
        while (left := t - time.monotonic()) > 0:
            time.sleep(min(left, _MAX_SLEEP))

    def spin_until(self, t: float) -> None:
        while time.monotonic() < t:
            pass

    def call_at(self, t: float, action: Callable[[float], None]) -> None:
        timer = threading.Timer(t - time.monotonic(), action, [t])
        timer.daemon = True
        timer.start()

    def follower(self) -> WallClock:
        return self


class VirtualClock:
    """A clock that moves only while its one leader sleeps; actions run in order of time meanwhile."""

    patience = 1.0  # in real time, so that a busy computer does not look like a silent board

    def __init__(self) -> None:
        self._now = 0.0
        self._actions: list[tuple[float, int, Callable[[float], None]]] = []
        self._order = count()
        self._barriers: list[Callable[[], None]] = []

    def now(self) -> float:
        return self._now

    def call_at(self, t: float, action: Callable[[float], None]) -> None:
        """Call `action(t)` when time reaches `t`, in the leader's thread."""
        heapq.heappush(self._actions, (max(t, self._now), next(self._order), action))

    def add_barrier(self, barrier: Callable[[], None]) -> None:
        """Call `barrier()` each time before time moves, for example to wait for bytes."""
        self._barriers.append(barrier)

    def sleep_until(self, t: float) -> None:
        for barrier in self._barriers:
            barrier()
        while self._actions and self._actions[0][0] <= t:
            when, _, action = heapq.heappop(self._actions)
            self._now = max(self._now, when)
            action(when)
        self._now = max(self._now, t)

    def spin_until(self, t: float) -> None:
        self.sleep_until(t)

    def follower(self) -> Clock:
        return _FollowerClock(self)


class _FollowerClock:
    patience = VirtualClock.patience

    def __init__(self, leader: VirtualClock):
        self._leader = leader

    def now(self) -> float:
        return self._leader.now()

    def sleep_until(self, t: float) -> None:
        """Return at once: only the leader moves a virtual clock."""

    def spin_until(self, t: float) -> None:
        """Return at once, too."""

    def call_at(self, t: float, action: Callable[[float], None]) -> None:
        self._leader.call_at(t, action)

    def follower(self) -> Clock:
        return self
