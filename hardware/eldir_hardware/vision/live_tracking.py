"""Tracking while the pictures arrive: the first ones calibrate the plane, then every picture is tracked."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.trajectory import Trajectory
from eldir_hardware.camera.plane import Image, Plane, TagBoard
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.markers.registration import DEFAULT_KIND, PALETTE, load_kind
from eldir_hardware.markers.tracker import MarkerTracker
from eldir_hardware.vision.pipeline import draw_overlay
from eldir_hardware.vision.recording_setup import CALIBRATION_FRAMES

FIRST_PICTURE_KEY = "first_picture_ns"
"""Name in a plane's provenance: stamp of the first picture that it was calibrated from [ns]."""
_MAX_TRAIL = 600  # the overlay shows at most so many positions of each marker


class LiveTracker:
    """Tracks a stream of pictures as `eldir track` tracks its log, without losing the first ones.

    Without a calibrated plane, pictures wait in a buffer until `CALIBRATION_FRAMES` of them have shown
    the plane of motion; they are then tracked as well.
    """

    def __init__(
        self,
        board: TagBoard | None = None,
        plane: Plane | None = None,
        layout: FloatArray | None = None,
        marker: str = DEFAULT_KIND,
    ):
        """`board`: places of the reference tags. `plane`: a calibrated plane, which needs no tags.
        `layout` (K, 2) [m]: where the design has the markers; it also says how many there are.
        `marker`: the kind of marker."""
        self._kind = load_kind(marker)
        self.names: tuple[str, ...] = tuple(PALETTE)[: None if layout is None else len(layout)]
        self._board = board
        self._given_plane = plane
        self._layout = layout
        self._tracker: MarkerTracker[Any] | None = None
        self._buffer: list[tuple[int, Image]] = []
        self._origin_ns: int | None = None

    @property
    def plane(self) -> Plane | None:
        """The plane that pictures are tracked in; None before it is calibrated."""
        return self._given_plane if self._tracker is None else self._tracker.plane

    @property
    def notes(self) -> list[str]:
        """Remarks for the user on the tags and the markers; empty until the markers are found."""
        if self._tracker is None or not self._tracker.acquired:
            return []
        remark = self._tracker.plane.provenance.get("remark")
        return [*([remark] if remark else []), *self._tracker.notes]

    def set_board(self, board: TagBoard) -> None:
        """Set the places of the reference tags; ignored if they are known already."""
        if self._board is None:
            self._board = board

    def reset(self, origin_ns: int | None = None) -> None:
        """Forget the pictures so far, as at the start of a run: tags, design and a given plane stay.

        The tracker counts its time from `origin_ns` [ns], or else from the first picture to come.
        """
        self._tracker = None
        self._buffer.clear()
        self._origin_ns = origin_ns

    def update(self, stamp_ns: int, image: Image) -> list[tuple[int, FloatArray, Image]]:
        """Stamp [ns], positions (K, 2) [m] of the markers and picture, of each picture tracked by this call.

        The list is empty while the plane is not known, holds the buffered pictures once it is, and
        later this one. `image` (H, W, 3) is BGR. Positions are NaN where a marker is not seen.
        Raises `EldirError` where the pictures do not show the plane or contradict the design; the
        buffer is then empty, and the next pictures are tried anew.
        """
        self._buffer.append((stamp_ns, image))
        try:
            tracker = self._tracker or self._start_tracker()
            return [] if tracker is None else self._track_buffer(tracker)
        except EldirError:
            self._buffer.clear()
            raise

    def _start_tracker(self) -> MarkerTracker[Any] | None:
        plane = self._given_plane
        if plane is None:
            self._buffer = self._buffer[-CALIBRATION_FRAMES:]
            if self._board is None or len(self._buffer) < CALIBRATION_FRAMES:
                return None
            origin = {"source": "live pictures", FIRST_PICTURE_KEY: self._buffer[0][0]}
            plane = calibrate_plane([image for _, image in self._buffer], self._board, origin)
        self._tracker = self._kind.tracker(plane, self.names, self._layout)
        return self._tracker

    def _track_buffer(self, tracker: MarkerTracker[Any]) -> list[tuple[int, FloatArray, Image]]:
        pictures, self._buffer = self._buffer, []
        origin = self._origin_ns = pictures[0][0] if self._origin_ns is None else self._origin_ns
        return [(at, tracker.update(image, 1e-9 * (at - origin)), image) for at, image in pictures]


class LiveOverlay:
    """Collects positions of markers and draws their paths; `is_due` limits how often."""

    def __init__(self, names: tuple[str, ...]):
        self._names = names
        self._trail: deque[tuple[float, FloatArray]] = deque(maxlen=_MAX_TRAIL)
        self._last_drawing = -np.inf

    def add(self, t: float, positions: FloatArray) -> None:
        """Positions (K, 2) [m] of the markers at `t` [s]; NaN where a marker was not visible."""
        self._trail.append((t, positions))

    def is_due(self, t: float, period: float) -> bool:
        """Whether the last drawing is at least `period` [s] old at `t` [s]."""
        return t - self._last_drawing >= period

    def draw(self, image: Image, plane: Plane) -> bytes:
        """PNG of the picture with the paths of the markers."""
        times, positions = zip(*self._trail, strict=True)
        self._last_drawing = times[-1]
        return draw_overlay(image, plane, Trajectory(self._names, np.array(times), np.array(positions)))
