"""A real camera that films a run in a separate thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from math import inf

import numpy as np
from numpy.typing import NDArray

from eldir.errors import EldirError, InputError
from eldir_hardware.resource import Resource
from eldir_hardware.rig.addresses import hide_password
from eldir_hardware.rig.sections import LiveCameraEntry
from eldir_hardware.run.filming import STALL, FilmLog
from eldir_hardware.vision.live import CameraDevice

_LETTING_GO = 2.0  # a picture that does not come may hold the thread for so long at the end [s]


class LiveCamera(Resource):
    """A live camera, between `open` and `close` or in a `with`.

    A thread reads its pictures all the time, so that no recorded picture has waited in the driver.
    """

    def __init__(self, entry: LiveCameraEntry):
        self._entry = entry
        self._record: Callable[[float, NDArray[np.uint8]], None] | None = None
        self._trouble: EldirError | None = None
        self._enough = threading.Event()
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)

    def open(self) -> None:
        """Take the first picture and start reading. Raises `InputError` where the camera cannot be opened, or
        its pictures have another size than the rig file says."""
        entry = self._entry
        wanted = entry.width, entry.height
        self._frames = CameraDevice(entry.device, inf, size=wanted, rate=entry.rate_hz).frames()
        _, image = next(self._frames)
        found = image.shape[1::-1]
        if found != wanted:
            self._frames.close()
            raise InputError(
                f"the pictures of {hide_password(entry.device)} have another size than the rig file says",
                code="camera.other-size",
                expected=f"{wanted[0]} x {wanted[1]}",
                found=f"{found[0]} x {found[1]}",
                remedy="set camera.width and camera.height in the rig file, and calibrate for that size",
            )
        self._thread.start()

    def close(self) -> None:
        """Stop reading; a picture that does not come is not waited for."""
        self._enough.set()
        self._thread.join(_LETTING_GO)

    @contextmanager
    def filming(self, log: FilmLog) -> Iterator[Callable[[float], None]]:
        """A function that begins to record pictures, from a start [s of the monotonic clock] on.

        A camera that fails does not stop the run; its error is raised at the end.
        """
        start = latest = inf

        def begin(at: float) -> None:
            nonlocal start, latest
            start = latest = at
            self._record = record

        def record(t: float, image: NDArray[np.uint8]) -> None:
            nonlocal latest
            if t < start:
                return
            if t - latest > STALL:
                log.on_stall(t - start, t - latest)
            latest = t
            log.on_frame(t - start, image)

        try:
            yield begin
        finally:
            self._record = None
            if (end := time.monotonic()) - latest > STALL:
                log.on_stall(end - start, end - latest)
        if self._trouble is not None:
            filmed = latest - start if latest < inf else 0.0
            raise EldirError(f"{self._trouble}; the log has pictures until {filmed:.1f} s")

    def _read(self) -> None:
        with closing(self._frames):
            try:
                for t, image in self._frames:
                    if self._enough.is_set():
                        return
                    if (record := self._record) is not None:
                        record(t, image)
            except EldirError as error:
                self._trouble = error
