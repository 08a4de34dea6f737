"""The process that sends the words of one run: it follows the log, the latch, and the program that drives.

It is told on its input what to follow, so that no command line shows an address. The input's end means that
the run has ended; that of the program that started it, that this one was killed.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from select import select
from typing import Any

from eldir.core import program_log
from eldir.errors import EldirError
from hardware.log.following import LogFollower
from hardware.notify.delivery import LONGEST, Delivery
from hardware.notify.words import Words
from hardware.safety.latch import DIED, stop_of

_logger = logging.getLogger(__name__)
_POLL = 0.5  # [s]
_LATCHING = 3.0  # from the death of the program that drives until its guardian has latched the stop [s]
_LOWEST = 19  # priority


class Sender:
    """Follows one run to its end."""

    def __init__(self, told: dict[str, Any]):
        """`told`: log, rig (its name), port (None for a virtual rig), camera (whether there is one),
        addresses."""
        self._told = told
        self._path = Path(told["log"])
        self._log: LogFollower | None = None
        self._words = Words(told["camera"])
        self._latched = self._stop()  # before the run: told by whoever latched it
        self._sent: list[Delivery] = []

    def run(self) -> None:
        """Send words until the run has ended, then wait for their delivery, and say which failed."""
        driver = os.pidfd_open(os.getppid())
        over = False
        while not over:
            ready, _, _ = select([0, driver], [], [], _POLL)
            over = bool(ready)
            for title, text in self._news():
                self._send(title, text)
            over = over or (self._log is not None and self._log.ended)
            if not over:
                self._tell_latch()
        if self._log is None:  # nothing was recorded: the run was refused, and whoever started it knows
            return
        written = self._log.ended
        deadline = time.monotonic() + _LATCHING
        while not written and self._stop() == DIED and time.monotonic() < deadline:
            time.sleep(0.1)
        title, text = self._words.end(written)
        if (stop := self._stop()) is not None and stop != self._latched:
            text += f". The stop is latched ({stop}): eldir rig reset"
        self._send(title, text)
        self._say_failures()

    def _news(self) -> Iterator[tuple[str, str]]:
        with suppress(EldirError, OSError):  # no log yet, or a damaged one: its end is told all the same
            if self._log is None:
                log = LogFollower(self._path)
                log.open()
                self._log = log
            for followed in self._log.poll():
                yield from self._words.take(followed, self._log)

    def _stop(self) -> str | None:
        with suppress(EldirError):
            return None if self._told["port"] is None else stop_of(self._told["port"])
        return None

    def _tell_latch(self) -> None:
        """A stop that is latched while the program that drives does not end, as when it is suspended."""
        stop = self._stop()
        if stop not in (None, DIED, self._latched):
            self._latched = stop
            self._send("stop latched", f"{stop}. To heat again: eldir rig reset")

    def _send(self, title: str, text: str) -> None:
        self._sent.append(
            Delivery(self._told["addresses"], f"{self._told['rig']}: {title}", f"{self._path.name}: {text}")
        )

    def _say_failures(self) -> None:
        failed: dict[str, str] = {}
        deadline = time.monotonic() + LONGEST
        for delivery in self._sent:
            failed |= delivery.failures(max(deadline - time.monotonic(), 0.0))
        for name, problem in failed.items():
            _logger.warning("no word was sent: %s of notify %s: eldir rig doctor", name, problem)


def main() -> None:
    os.nice(_LOWEST)
    program_log.configure("notify")
    line = sys.stdin.buffer.readline()
    if line:
        Sender(json.loads(line)).run()
    os._exit(0)  # an address that does not answer holds nobody up


if __name__ == "__main__":
    main()
