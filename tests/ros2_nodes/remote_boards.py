"""A relay board node behind messages, as a remote bank meets it."""

import threading
import time

from eldir_msgs.msg import HeatCommand

from eldir_ros.conversions.board import BoardState
from eldir_ros.remote.remote_bank import RemoteBank

RUN = "a run"


class Board:
    """A relay board node that reports fifty times a second, until it is `dead`.

    `skew`: how much its computer's time of day is ahead [s]. `deaf`: it obeys no command any more. `slow`:
    its reports were read so long ago [s].
    """

    def __init__(self, armed=True):
        self.skew, self.slow, self.deaf, self.obeyed = 0.0, 0.0, False, 0
        self.armed, self.closed, self.dead, self.stopped, self.welded = armed, (), False, "", False
        self.commands: list[int] = []
        self.pulses: list[dict[int, float]] = []
        self.delays: list[float] = []
        self.missing: tuple[str, ...] = ()
        self.bank = self.new_bank()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._report)
        self._thread.start()

    def new_bank(self):
        return RemoteBank(self, RUN, lambda: self.missing, lambda: self.stopped)

    def send_command(self, command, sequence):
        self.commands.append(command)
        if self.deaf:
            return
        self.obeyed = sequence
        if command in (HeatCommand.ABORT, HeatCommand.END_OF_RUN) and not self.welded:
            self.closed = ()

    def send_pulses(self, delay, lengths, sequence):
        self.pulses.append(dict(lengths))
        self.delays.append(delay)
        if not self.deaf:
            self.obeyed, self.closed = sequence, tuple(lengths)

    def _report(self):
        while not self._over.wait(0.02):
            if not self.dead:
                read = time.time_ns() + round(1e9 * (self.skew - self.slow))
                closed = tuple(c in self.closed for c in (1, 2))
                names, heat = ("channel1", "channel2"), (30.0,)
                state = BoardState(
                    read, self.slow, RUN, self.obeyed, self.armed, names, closed, ("s",), heat, 30.0, 0.0
                )
                self.bank.report(state)

    def close(self):
        self._over.set()
        self._thread.join()
