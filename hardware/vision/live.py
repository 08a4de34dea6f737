"""Frames from a camera while it films."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import cv2

from calibration.plane import Image
from eldir.errors import InputError
from hardware.vision.codecs import quiet

_NAME = re.compile(r"camera:(\d+)|(/dev/video\d+)")
_TOO_OLD = 1.0
"""A driver whose clock differs by more from ours has another epoch, and is not asked [s]."""


def is_camera(name: str) -> bool:
    """Whether a name means a camera: camera:0, /dev/video0."""
    return _NAME.fullmatch(name) is not None


@dataclass(frozen=True)
class Camera:
    """A camera of this computer; each pass through it films anew, for `seconds`."""

    name: str
    """Such as camera:0 or /dev/video0."""
    seconds: float
    attachments: dict[str, bytes] = field(default_factory=dict)
    open: Callable[[Any], Any] = cv2.VideoCapture
    """Opens a device by number or path."""

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        """Time since the first frame [s], of exposure where the driver tells it, and picture."""
        found = _NAME.fullmatch(self.name)
        assert found is not None
        quiet()
        capture = self.open(int(found[1]) if found[1] else found[2])
        try:
            first = None
            while True:
                good, image = capture.read()
                now = time.monotonic()
                if not good:
                    raise InputError(
                        f"{self.name} gives no picture" + ("" if first is None else " any more"),
                        expected="a camera that nothing else uses",
                        remedy="check its cable, and what there is: ls /dev/video*",
                    )
                stamp = capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3  # V4L2 stamps on the monotonic clock
                t = stamp if abs(now - stamp) < _TOO_OLD else now
                first = t if first is None else first
                if t - first > self.seconds:
                    return
                yield t - first, image
        finally:
            capture.release()
