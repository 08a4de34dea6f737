"""What a log says that is worth a word: how the run ended, and that no pictures come."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, isfinite

from hardware.log import messages as m
from hardware.log.following import Followed, LogFollower

CAMERA_LOST = 3.0
"""The camera counts as lost after so long without a picture [s of the run]."""
_GOOD = 0  # level of diagnostic_msgs


class Words:
    """Follows one run in its log."""

    def __init__(self, has_camera: bool):
        self._has_camera = has_camera
        self._latest = self._picture = 0.0
        self._hottest = -inf
        self._last: tuple[bool, str] | None = None

    def take(self, followed: Followed, log: LogFollower) -> Iterator[tuple[str, str]]:
        """Words, as title and text, that one message gives rise to."""
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
        if self._has_camera and t - self._picture > CAMERA_LOST:
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
