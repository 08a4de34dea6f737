"""One run as a log, from messages that carry their own stamps and may arrive late."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eldir.core.records import FileRecord, FloatArray
from eldir_hardware.camera.lens import Lens
from eldir_hardware.images import jpeg
from eldir_hardware.log.background import BackgroundRecorder
from eldir_hardware.log.recorder import Recorder

AFTER = 1.5
"""Time after the end of a run in which its last tracks and reports still arrive [s]."""


class RunRecording:
    """A log that takes stamps [ns] instead of times, and only what belongs to the run.

    Pictures and tracks count from the start of the schedule, as in a log of `eldir rig drive`; reports of
    the board and statuses also before. What is stamped later than the end is ignored. Every method
    raises `EldirError` where the log cannot be written.
    """

    def __init__(
        self,
        path: Path,
        channels: Sequence[str],
        springs: Sequence[str],
        start_ns: int,
        lens: Lens | None = None,
    ):
        """`channels` and `springs` as in `Recorder`; the schedule starts at `start_ns`."""
        self.path = path
        self.camera_known = lens is not None
        """Whether the log holds the camera's lens already."""
        self._start_ns = start_ns
        self._size: tuple[int, int] | None = None
        self._end_ns: int | None = None
        self._ending = ("", False)
        self._close_at = float("inf")
        self._stack = ExitStack()
        self._log = self._stack.enter_context(
            BackgroundRecorder(Recorder(path, channels, springs, start_ns, lens))
        )

    def attach(self, files: Mapping[str, FileRecord | bytes]) -> None:
        """Keep files with the log, by name: YAML or JSON."""
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
        """The lens that a camera's driver reports; only the first counts, none if there is a lens file."""
        if not self.camera_known:
            self.camera_known = True
            self._write(stamp_ns, lambda t: self._log.on_camera_info(t, info), before=True)

    def on_tracks(self, stamp_ns: int, names: Sequence[str], positions: FloatArray) -> None:
        """Where the marks are in the plane (K, 2) [m]; one that was not seen is NaN."""
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

    def on_fault(self, stamp_ns: int, name: str, message: str) -> None:
        """A fault of a part of the rig."""
        self._write(stamp_ns, lambda t: self._log.on_status(t, name, message, good=False), before=True)

    def end(self, stamp_ns: int, now: float, message: str, good: bool) -> None:
        """The run has ended; the log waits until `AFTER` later than `now` [s] for what is still to come."""
        self._end_ns, self._ending, self._close_at = stamp_ns, (message, good), now + AFTER

    def is_due(self, now: float) -> bool:
        """Whether the run has ended and the log should be closed."""
        return now > self._close_at

    def close(self, now_ns: int, reason: str) -> None:
        """Write how the run ended and close the log; `reason` counts where `end` was not called before."""
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
