"""The process that sends the notifications of one run: follows log, latch and the driving program.

It reads its job from its input, so that no address shows in a list of processes. The end of the input means
that the run has ended; the end of the parent process, that the driving program was killed.
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
from eldir_app.notifications import DELIVERY_TIMEOUT_S, Delivery
from eldir_hardware.log import messages as m
from eldir_hardware.log.following import LogFollower, LogMessage
from eldir_hardware.safety.latch import GUARDIAN_DIED, read_stop

_logger = logging.getLogger(__name__)
_POLL_INTERVAL_S = 0.5
_LATCH_TIMEOUT_S = 3.0  # from the death of the driving program until its guardian has latched the stop
_LOWEST_PRIORITY = 19
_CAMERA_TIMEOUT_S = 3.0  # the camera counts as lost after so long without a frame, in the run's time
_LEVEL_OK = 0  # of diagnostic_msgs


class NotificationSender:
    """Follows one run to its end."""

    def __init__(self, job: dict[str, Any]):
        """`job`: log, rig (its name), port (None for a virtual rig), camera (whether there is one),
        addresses."""
        self._job = job
        self._path = Path(job["log"])
        self._log: LogFollower | None = None
        self._events = _RunEvents(job["camera"])
        self._known_stop = self._latched_stop()  # latched before the run: its own command reported it
        self._deliveries: list[Delivery] = []

    def run(self) -> None:
        """Send notifications until the run has ended, wait for their delivery, and log which failed."""
        driver = os.pidfd_open(os.getppid())
        ended = False
        while not ended:
            ready, _, _ = select([0, driver], [], [], _POLL_INTERVAL_S)
            ended = bool(ready)
            for title, text in self._read_events():
                self._send(title, text)
            ended = ended or (self._log is not None and self._log.is_finished)
            if not ended:
                self._notify_latch()
        if self._log is None:  # nothing was recorded: the run was refused, and its command said why
            return
        complete = self._log.is_finished
        deadline = time.monotonic() + _LATCH_TIMEOUT_S
        while not complete and self._latched_stop() == GUARDIAN_DIED and time.monotonic() < deadline:
            time.sleep(0.1)
        title, text = self._events.end(complete)
        if (stop := self._latched_stop()) is not None and stop != self._known_stop:
            text += f". The stop is latched ({stop}): eldir rig reset"
        self._send(title, text)
        self._log_failures()

    def _read_events(self) -> Iterator[tuple[str, str]]:
        with suppress(EldirError, OSError):  # the log does not exist yet, or is damaged
            if self._log is None:
                log = LogFollower(self._path)
                log.open()
                self._log = log
            for message in self._log.poll():
                yield from self._events.update(message, self._log)

    def _latched_stop(self) -> str | None:
        """Why the stop is latched; None if it is not, or cannot be read."""
        with suppress(EldirError):
            return None if self._job["port"] is None else read_stop(self._job["port"])
        return None

    def _notify_latch(self) -> None:
        """Notify of a stop that is latched although the driving program lives, such as a suspended one."""
        stop = self._latched_stop()
        if stop not in (None, GUARDIAN_DIED, self._known_stop):
            self._known_stop = stop
            self._send("stop latched", f"{stop}. To heat again: eldir rig reset")

    def _send(self, title: str, text: str) -> None:
        self._deliveries.append(
            Delivery(self._job["addresses"], f"{self._job['rig']}: {title}", f"{self._path.name}: {text}")
        )

    def _log_failures(self) -> None:
        failures: dict[str, str] = {}
        deadline = time.monotonic() + DELIVERY_TIMEOUT_S
        for delivery in self._deliveries:
            failures |= delivery.failures(max(deadline - time.monotonic(), 0.0))
        for name, problem in failures.items():
            _logger.warning("notification not sent: %s of notify %s: eldir rig doctor", name, problem)


class _RunEvents:
    """The events in a log that are notified: how the run ended, and a camera without frames."""

    def __init__(self, has_camera: bool):
        self._has_camera = has_camera
        self._latest_t = self._frame_t = 0.0
        self._peak_c = -inf
        self._last_status: tuple[bool, str] | None = None

    def update(self, logged: LogMessage, log: LogFollower) -> Iterator[tuple[str, str]]:
        """Take one message; yield the title and the text of each notification that follows from it."""
        if log.epoch_ns is None:
            return
        t, topic, message = (logged.stamp_ns - log.epoch_ns) * 1e-9, logged.topic, logged.message
        self._latest_t = max(self._latest_t, t)
        if topic == m.IMAGE:
            self._frame_t = t
        elif topic.startswith("/springs/"):
            self._peak_c = max(message.temperature, self._peak_c)
        elif topic == m.STATUS:
            for status in message.status:
                if status.name == "player":
                    self._last_status = status.level == _LEVEL_OK, status.message
        if self._has_camera and t - self._frame_t > _CAMERA_TIMEOUT_S:
            self._has_camera = False  # one notification is enough
            yield "camera lost", f"no frame since {self._frame_t:.0f} s; the heating goes on"

    def end(self, complete: bool) -> tuple[str, str]:
        """The last notification. `complete`: the log was finished, so that its last status tells how the run
        ended."""
        duration = f"{self._latest_t:.0f} s"
        if not complete or self._last_status is None:
            return "stopped", f"after {duration}: the driving program has died"
        ok, text = self._last_status
        if not ok:
            return "stopped", f"after {duration}: {text}"
        peak = f", highest modelled temperature {self._peak_c:.1f} C" if isfinite(self._peak_c) else ""
        return "finished", f"{text}: {duration}{peak}"


def main() -> None:
    os.nice(_LOWEST_PRIORITY)
    program_log.configure("notify")
    line = sys.stdin.buffer.readline()
    if line:
        NotificationSender(json.loads(line)).run()
    os._exit(0)  # do not wait for threads of addresses that do not answer


if __name__ == "__main__":
    main()
