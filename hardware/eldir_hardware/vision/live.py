"""Frames from a camera while it films."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import cv2

from eldir.errors import InputError
from eldir_hardware.camera.plane import Image
from eldir_hardware.images.jpeg import silence_opencv
from eldir_hardware.rig.addresses import CAMERA_NAME, hide_password

_MAX_CLOCK_DIFFERENCE = 1.0
"""If a driver's clock differs from ours by more than this, its timestamps are not used [s]."""
_STREAM_REMEDY = "check its address, and that the camera is on and in this network"
_REMEDY = "check its cable, and what there is: ls /dev/video*"


@dataclass(frozen=True)
class CameraDevice:
    """A camera of this computer or a network stream; each iteration films for `seconds` again."""

    name: str
    """Name of the camera, such as camera:0, /dev/video0 or http://phone:8080/video."""
    seconds: float
    attachments: dict[str, bytes] = field(default_factory=dict)
    open: Callable[[Any], Any] = cv2.VideoCapture
    """Opens a device by number, or by path or address."""
    size: tuple[int, int] | None = None
    """Width and height to request from a device [px]; a stream sets its own."""
    rate: float | None = None
    """Frame rate to request from a device [1/s]."""

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        """Time since the first frame [s] (time of exposure if the driver reports it), and picture."""
        first = None
        with closing(self.frames()) as frames:
            for t, image in frames:
                first = t if first is None else first
                if t - first > self.seconds:
                    return
                yield t - first, image

    def frames(self) -> Generator[tuple[float, Image]]:
        """Endless frames: time on the monotonic clock [s] (of exposure if the driver reports it, else of
        arrival), and picture. Raises `InputError` if the camera gives no picture."""
        match = CAMERA_NAME.fullmatch(self.name)
        assert match is not None
        number, path, stream = match["number"], match["path"], match["stream"]
        silence_opencv()
        capture = self.open(int(number) if number else path or stream)
        try:
            self._configure(capture)
            pictures = 0
            while True:
                good, image = capture.read()
                now = time.monotonic()
                if not good:
                    raise InputError(
                        f"{hide_password(self.name)} gives no picture" + (" any more" if pictures else ""),
                        code="camera.no-picture",
                        expected="a video stream" if stream else "a camera that nothing else uses",
                        remedy=_STREAM_REMEDY if stream else _REMEDY,
                    )
                stamp = capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3  # V4L2 stamps on the monotonic clock
                yield stamp if not stream and abs(now - stamp) < _MAX_CLOCK_DIFFERENCE else now, image
                pictures += 1
        finally:
            capture.release()

    def _configure(self, capture: Any) -> None:
        if self.size is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self.size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self.size[1])
        if self.rate is not None:
            capture.set(cv2.CAP_PROP_FPS, self.rate)
