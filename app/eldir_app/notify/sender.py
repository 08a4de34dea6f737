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
from math import inf, isfinite
from pathlib import Path
from select import select
from typing import Any

from eldir.core import program_log
from eldir.errors import EldirError
from eldir_app.notify.delivery import LONGEST, Delivery
from eldir_hardware.log import messages as m
from eldir_hardware.log.following import LogFollower, LogMessage
from eldir_hardware.safety.latch import DIED, stop_of

_logger = logging.getLogger(__name__)
_POLL = 0.5  # [s]
_LATCHING = 3.0  # from the death of the program that drives until its guardian has latched the stop [s]
_LOWEST = 19  # priority
_CAMERA_LOST = 3.0  # the camera counts as lost after so long without a picture [s of the run]
_GOOD = 0  # level of diagnostic_msgs


class Sender:
    """Follows one run to its end."""

    def __init__(self, told: dict[str, Any]):
        """`told`: log, rig (its name), port (None for a virtual rig), camera (whether there is one),
        addresses."""
        self._told = told
        self._path = Path(told["log"])
        self._log: LogFollower | None = None
        self._words = _Notifications(told["camera"])
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


class _Notifications:
    """What a log says that is worth a notification: how the run ended, and that no pictures come."""

    def __init__(self, has_camera: bool):
        self._has_camera = has_camera
        self._latest = self._picture = 0.0
        self._hottest = -inf
        self._last: tuple[bool, str] | None = None

    def take(self, followed: LogMessage, log: LogFollower) -> Iterator[tuple[str, str]]:
        """Notifications, as title and text, that one message gives rise to."""
        if log.epoch_ns is None:
            return
        t, topic, message = (followed.stamp_ns - log.epoch_ns) * 1e-9, followed.topic, followed.message
        self._latest = max(self._latest, t)
        if topic == m.IMAGE:
            self._picture = t
        elif topic.startswith("/springs/"):
            self._hottest = max(message.temperature, self._hottest)
        elif topic == m.STATUS:
            for status in message.status:
                if status.name == "player":
                    level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                    self._last = level == _GOOD, status.message
        if self._has_camera and t - self._picture > _CAMERA_LOST:
            self._has_camera = False  # told once
            yield "camera lost", f"no picture since {self._picture:.0f} s; the heating goes on"

    def end(self, written: bool) -> tuple[str, str]:
        """The last word; `written`: the log was finished, so that its last event is how the run ended."""
        took = f"{self._latest:.0f} s"
        if not written or self._last is None:
            return "stopped", f"after {took}: the program that drove it has died"
        good, text = self._last
        if not good:
            return "stopped", f"after {took}: {text}"
        hottest = f", highest modelled temperature {self._hottest:.1f} C" if isfinite(self._hottest) else ""
        return "finished", f"{text}: {took}{hottest}"


def main() -> None:
    os.nice(_LOWEST)
    program_log.configure("notify")
    line = sys.stdin.buffer.readline()
    if line:
        Sender(json.loads(line)).run()
    os._exit(0)  # an address that does not answer holds nobody up


if __name__ == "__main__":
    main()
