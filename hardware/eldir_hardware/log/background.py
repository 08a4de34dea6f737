"""Recorders that never delay the rig, as a separate thread writes the log.

If the disk or the processor is too slow, pictures are dropped and counted first. Tracks, relays and
temperatures are dropped only when 100 000 of them wait.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from copy import deepcopy
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec

import numpy as np
from numpy.typing import NDArray

from eldir.core.records import FileRecord, FloatArray
from eldir.errors import EldirError
from eldir_hardware.camera.lens import Lens
from eldir_hardware.images import jpeg
from eldir_hardware.log.messages import ROOM
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.resource import Resource

MAX_PICTURES = 32
"""Largest number of waiting pictures: half a second at 60 frames/s, 30 MB at 640 x 480."""
MAX_MESSAGES = 100_000
"""Largest number of other waiting messages: some minutes."""
_SYNC_INTERVAL = 0.4
"""Interval at which records are forced onto the disk [s]."""
_FLUSH_INTERVAL = 0.1
"""Interval at which records become visible to programs that follow the log [s]."""


_Values = ParamSpec("_Values")
CLOSING_DELAY = 1.5
"""Time after the end of a run in which its last tracks and reports arrive [s]."""


def _in_background(
    method: Callable[Concatenate[Recorder, float, _Values], None], picture: bool = False
) -> Callable[Concatenate[BackgroundRecorder, float, _Values], None]:
    """A method that lets the thread call this method of `Recorder` later, with the present values."""

    @wraps(method)
    def put(self: BackgroundRecorder, t: float, *values: _Values.args, **named: _Values.kwargs) -> None:
        kept = [deepcopy(v) if isinstance(v, list | np.ndarray) and not picture else v for v in values]
        self._enqueue(t, picture, lambda: getattr(self._recorder, method.__name__)(t, *kept, **named))

    return put


class BackgroundRecorder(Resource):
    """Wraps a `Recorder` and has its methods. Use it between `open` and `close`, or in a `with`."""

    def __init__(self, recorder: Recorder, sync: float = _SYNC_INTERVAL):
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

    on_frame = _in_background(Recorder.on_frame, picture=True)  # the caller must not change it afterwards
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
        self._enqueue(self._latest, False, lambda: self._recorder.begin_at(epoch_ns))

    def attach(self, name: str, file: FileRecord | bytes) -> None:
        """Attach a file to the log, as `GrowingLog.attach`."""
        self._enqueue(self._latest, False, lambda: self._recorder.attach(name, file))

    def _enqueue(self, t: float, picture: bool, write: Callable[[], None]) -> None:
        with self._changed:
            if self._failure is not None:
                raise self._failure
            self._latest = max(self._latest, t)
            if picture and self._pictures >= MAX_PICTURES:
                self.dropped_pictures += 1
            elif len(self._waiting) >= MAX_MESSAGES:
                self.dropped_others += 1
            else:
                self._pictures += picture
                self._waiting.append((picture, write))
                self._changed.notify()

    def _write(self) -> None:
        sync_at, flush_at = time.monotonic() + self._sync, time.monotonic() + _FLUSH_INTERVAL
        try:
            while (batch := self._next_batch(min(sync_at, flush_at))) is not None:
                for write in batch:
                    write()
                now = time.monotonic()
                if now >= sync_at:
                    self._recorder.sync()
                    sync_at = now + self._sync
                elif now >= flush_at:
                    self._recorder.flush()
                    flush_at = now + _FLUSH_INTERVAL
        except Exception as error:  # raised at the next message, and at the end
            with self._changed:
                self._failure = error if isinstance(error, EldirError) else _wrap_error(error)
                self._waiting.clear()

    def _next_batch(self, due: float) -> list[Callable[[], None]] | None:
        """The waiting messages, with at most one picture; empty at the time `due`, None at the end."""
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


def _wrap_error(error: Any) -> EldirError:
    return EldirError(f"the log cannot be written: {type(error).__name__}: {error}")


class RunRecording:
    """The log of one run from messages with time stamps [ns], which may arrive late.

    Pictures and tracks count from the start of the schedule, as in a log of `eldir rig drive`; reports of
    the board and statuses also before. Messages with stamps after the end are ignored. Every method raises
    `EldirError` if the log cannot be written.
    """

    def __init__(
        self,
        path: Path,
        channels: Sequence[str],
        springs: Sequence[str],
        start_ns: int,
        lens: Lens | None = None,
        room_c: float | None = None,
    ):
        """`channels` and `springs` as in `Recorder`; the schedule starts at `start_ns`. `room_c`: temperature
        of the air, measured before the run [C]."""
        self.path = path
        self.camera_known = lens is not None
        """Whether the log holds the camera's lens already."""
        self._start_ns = start_ns
        self._size: tuple[int, int] | None = None
        self._end_ns: int | None = None
        self._ending = ("", False)
        self._close_at = float("inf")
        self._stack = ExitStack()
        facts = None if room_c is None else {ROOM: f"{room_c:g}"}
        self._log = self._stack.enter_context(
            BackgroundRecorder(Recorder(path, channels, springs, start_ns, lens, facts))
        )
        if room_c is not None:
            self.on_note("room", f"the air was measured before the run: {room_c:g} C")

    def attach(self, files: Mapping[str, FileRecord | bytes]) -> None:
        """Attach files to the log, by name: YAML or JSON."""
        for name, file in files.items():
            self._log.attach(name, file)

    def on_picture(self, stamp_ns: int, data: NDArray[np.uint8]) -> None:
        """A picture of the camera as JPEG bytes (N,)."""
        if self._size is None:
            height, width = jpeg.decode(data).shape[:2]
            self._size = (width, height)
        size = self._size
        self._write(stamp_ns, lambda t: self._log.on_picture(t, data, *size))

    def on_camera_info(self, stamp_ns: int, info: Mapping[str, Any]) -> None:
        """The lens that the camera's driver reports: only the first one, and not with a lens file."""
        if not self.camera_known:
            self.camera_known = True
            self._write(stamp_ns, lambda t: self._log.on_camera_info(t, info), before=True)

    def on_tracks(self, stamp_ns: int, names: Sequence[str], positions: FloatArray) -> None:
        """Positions of the markers in the plane (K, 2) [m]; NaN if not detected."""
        self._write(stamp_ns, lambda t: self._log.on_tracks(t, names, positions))

    def on_board(
        self,
        stamp_ns: int,
        closed: Sequence[bool],
        temperatures: Sequence[float],
        currents: Sequence[float] = (),
        voltages: Sequence[float] = (),
    ) -> None:
        """The board's report of its contacts, the modelled temperature of each spring [C], and, with a
        current sensor, its measured current [A] and voltage [V]."""
        self._write(stamp_ns, lambda t: self._log.on_relays(t, closed), before=True)
        self._write(stamp_ns, lambda t: self._log.on_temperatures(t, temperatures), before=True)
        if currents:
            self._write(stamp_ns, lambda t: self._log.on_currents(t, currents, voltages), before=True)

    def on_note(self, name: str, message: str) -> None:
        """A remark on a part of the rig, for the whole run."""
        self._log.on_status(0.0, name, message)

    def on_fault(self, stamp_ns: int, name: str, message: str) -> None:
        """A fault of a part of the rig."""
        self._write(stamp_ns, lambda t: self._log.on_status(t, name, message, good=False), before=True)

    def end(self, stamp_ns: int, now: float, message: str, good: bool) -> None:
        """Record the end of the run; the log stays open for `CLOSING_DELAY` after `now` [s]."""
        self._end_ns, self._ending, self._close_at = stamp_ns, (message, good), now + CLOSING_DELAY

    def is_due(self, now: float) -> bool:
        """Whether the run has ended and the log should be closed."""
        return now > self._close_at

    def close(self, now_ns: int, reason: str) -> None:
        """Write how the run ended and close the log; `reason` is used if `end` was not called."""
        stamp_ns, (message, good) = (
            (now_ns, (reason, False)) if self._end_ns is None else (self._end_ns, self._ending)
        )
        with self._stack:
            self._log.on_status(self._seconds(stamp_ns), "player", message, good=good)

    def _write(self, stamp_ns: int, write: Callable[[float], None], before: bool = False) -> None:
        early = stamp_ns < self._start_ns and not before
        late = self._end_ns is not None and stamp_ns > self._end_ns
        if not early and not late:
            write(self._seconds(stamp_ns))

    def _seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self._start_ns) * 1e-9
