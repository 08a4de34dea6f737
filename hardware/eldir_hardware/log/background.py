"""A recorder that never delays the rig: a separate thread writes the log.

If the disk or the processor is too slow, pictures are dropped and counted first. Tracks, relays and
temperatures are dropped only when 100 000 of them wait.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from functools import wraps
from typing import Any, Concatenate, ParamSpec

import numpy as np

from eldir.core.records import FileRecord
from eldir.errors import EldirError
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.resource import Resource

PICTURES = 32
"""Number of pictures that may wait: half a second at 60 frames/s, 30 MB at 640 x 480."""
SMALL = 100_000
"""Number of other messages that may wait: minutes."""
_SYNC = 0.4
"""Time until a record is on the disk [s]."""
_SHOW = 0.1
"""Time until who follows the log sees a record [s]."""


_Values = ParamSpec("_Values")


def _in_background(
    method: Callable[Concatenate[Recorder, float, _Values], None], picture: bool = False
) -> Callable[Concatenate[BackgroundRecorder, float, _Values], None]:
    """A method of `Recorder` that the thread calls later, with the values as they are now."""

    @wraps(method)
    def put(self: BackgroundRecorder, t: float, *values: _Values.args, **named: _Values.kwargs) -> None:
        kept = [deepcopy(v) if isinstance(v, list | np.ndarray) and not picture else v for v in values]
        self._put(t, picture, lambda: getattr(self._recorder, method.__name__)(t, *kept, **named))

    return put


class BackgroundRecorder(Resource):
    """Wraps a `Recorder` and has its methods. Use it between `open` and `close`, or in a `with`."""

    def __init__(self, recorder: Recorder, sync: float = _SYNC):
        self._recorder = recorder
        self._sync = sync
        self._waiting: deque[tuple[bool, Callable[[], None]]] = deque()
        self._pictures = 0
        self._changed = threading.Condition()
        self._closing = False
        self._failure: EldirError | None = None
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._latest = 0.0
        self.dropped_pictures = 0
        """Frames dropped since the start."""
        self.dropped_others = 0
        """Other messages dropped since the start."""

    def open(self) -> None:
        """Create the log's file and start the thread that writes it."""
        self._recorder.open()
        self._thread.start()

    def close(self) -> None:
        """Write what is waiting and finish the file. Raises `EldirError` where this failed."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()
        if self._failure is None and (self.dropped_pictures or self.dropped_others):
            with suppress(EldirError):  # a full disk is reported by `close` below
                self._recorder.on_status(self._latest, "log", "too slow", self.dropped, good=False)
        try:
            self._recorder.close()
        except EldirError as error:
            self._failure = self._failure or error
        if self._failure is not None:
            raise self._failure

    @property
    def dropped(self) -> dict[str, int]:
        """Counts of dropped messages, as in the log."""
        return {"dropped_frames": self.dropped_pictures, "dropped_messages": self.dropped_others}

    on_frame = _in_background(Recorder.on_frame, picture=True)  # which must not be changed afterwards
    on_picture = _in_background(Recorder.on_picture, picture=True)
    on_camera_info = _in_background(Recorder.on_camera_info)
    on_tracks = _in_background(Recorder.on_tracks)
    on_relays = _in_background(Recorder.on_relays)
    on_temperatures = _in_background(Recorder.on_temperatures)
    on_currents = _in_background(Recorder.on_currents)
    on_status = _in_background(Recorder.on_status)
    on_event = _in_background(Recorder.on_event)
    on_stall = _in_background(Recorder.on_stall)

    def begin_at(self, epoch_ns: int) -> None:
        """Set the time of day at t = 0, as `GrowingLog.begin_at`."""
        self._put(self._latest, False, lambda: self._recorder.begin_at(epoch_ns))

    def attach(self, name: str, file: FileRecord | bytes) -> None:
        """Attach a file to the log, as `GrowingLog.attach`."""
        self._put(self._latest, False, lambda: self._recorder.attach(name, file))

    def _put(self, t: float, picture: bool, write: Callable[[], None]) -> None:
        with self._changed:
            if self._failure is not None:
                raise self._failure
            self._latest = max(self._latest, t)
            if picture and self._pictures >= PICTURES:
                self.dropped_pictures += 1
            elif len(self._waiting) >= SMALL:
                self.dropped_others += 1
            else:
                self._pictures += picture
                self._waiting.append((picture, write))
                self._changed.notify()

    def _write(self) -> None:
        due, show = time.monotonic() + self._sync, time.monotonic() + _SHOW
        try:
            while (batch := self._next(min(due, show))) is not None:
                for write in batch:
                    write()
                now = time.monotonic()
                if now >= due:
                    self._recorder.sync()
                    due = now + self._sync
                elif now >= show:
                    self._recorder.show()
                    show = now + _SHOW
        except Exception as error:  # raised at the next message, and at the end
            with self._changed:
                self._failure = error if isinstance(error, EldirError) else _unexpected(error)
                self._waiting.clear()

    def _next(self, due: float) -> list[Callable[[], None]] | None:
        """The waiting messages, with at most one picture; none when a sync is due; None at the end."""
        with self._changed:
            while not self._waiting:
                if self._closing:
                    return None
                if not self._changed.wait(max(due - time.monotonic(), 0.0)):
                    return []
            batch: list[Callable[[], None]] = []
            while self._waiting:
                picture, write = self._waiting.popleft()
                self._pictures -= picture
                batch.append(write)
                if picture:
                    break
            return batch


def _unexpected(error: Any) -> EldirError:
    return EldirError(f"the log cannot be written: {type(error).__name__}: {error}")
