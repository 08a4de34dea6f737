"""Shared by the tests of remote bank and others."""

import threading
import time

from eldir_ros.conversions.board import BoardState
from eldir_ros.remote.remote_bank import CUT, END, RemoteBank


class Board:
    """A relay board node that reports ten times a second, until it is `dead`."""

    def __init__(self, armed=True):
        self.armed, self.closed, self.dead, self.stopped, self.welded = armed, (), False, "", False
        self.told: list[int] = []
        self.pulses: list[dict[int, float]] = []
        self.missing: tuple[str, ...] = ()
        self.bank = RemoteBank(self, lambda: self.missing, lambda: self.stopped)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._report)
        self._thread.start()

    def send_command(self, command):
        self.told.append(command)
        if command in (CUT, END) and not self.welded:
            self.closed = ()

    def send_pulses(self, at, lengths):
        self.pulses.append(dict(lengths))
        self.closed = tuple(lengths)

    def _report(self):
        while not self._over.wait(0.02):
            if not self.dead:
                now = time.time_ns()
                closed = tuple(c in self.closed for c in (1, 2))
                self.bank.report(
                    BoardState(now, ("channel1", "channel2"), closed, ("s",), (30.0,), self.armed, 30.0, 0.0),
                    now,
                )

    def close(self):
        self._over.set()
        self._thread.join()
