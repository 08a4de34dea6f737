"""From frames to a trajectory in metres: of a whole recording, or while the pictures arrive."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import EldirError, InputError
from eldir.trajectory import Trajectory
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Image, Plane, TagBoard
from eldir_hardware.camera.tags import DriftMonitor
from eldir_hardware.images.video import draw_ground
from eldir_hardware.log.reader import RunLog
from eldir_hardware.markers.registration import DEFAULT_KIND, PALETTE, load_kind, nominal_bgr
from eldir_hardware.markers.tracker import MarkerTracker
from eldir_hardware.vision.printed_ground import PrintedGround
from eldir_hardware.vision.recording_setup import (
    CALIBRATION_FRAMES,
    calibrate_with_recorded_lens,
    find_recorded_plane,
    read_attached_layout,
    read_marker_kind,
)
from eldir_hardware.vision.sources import LoggedFrames
from eldir_hardware.vision.tracking_quality import TrackingQuality

_ZOOM = 2  # of the overlay
_LABEL_SIZE = (18.0, 10.0)  # room of a marker's name on the overlay [px]
_MIN_BRIGHTNESS = 100  # of the brightest pixel [grey levels]
_MIN_COLOUR_RANGE = 12  # largest difference of a pixel's colours [grey levels]
_COARSE_ROWS = 24  # only every n-th row is compared first; this distinguishes most pictures
_MAX_UNSEEN_TAGS = 10.0  # something may hide them for so long at the end of a film [s]
FIRST_PICTURE_KEY = "first_picture_ns"
"""Name in a plane's provenance: stamp of the first picture that it was calibrated from [ns]."""
_MAX_TRAIL = 600  # the overlay shows at most so many positions of each marker


@dataclass(frozen=True)
class TrackingResult:
    """Result of tracking a source."""

    trajectory: Trajectory
    """Positions of the markers; gaps of up to half a second are interpolated and flagged."""
    quality: TrackingQuality
    last_frame: Image
    """The last frame, for the overlay."""
    sizes: FloatArray
    """How large each marker appeared, relative to the first frame; NaN where not visible, shape (T, K)."""


def track_frames(
    source: Iterable[tuple[float, Image]],
    plane: Plane,
    names: tuple[str, ...] = tuple(PALETTE),
    layout: FloatArray | None = None,
    progress: Callable[[int], None] = lambda frames: None,
    marker: str = DEFAULT_KIND,
) -> TrackingResult:
    """Track the markers in every frame of a source.

    `layout` (K, 2) [m]: places of the markers in the design. `progress` is called with the number of finished
    frames. `marker`: the kind of marker. A frame that is not later than the one before is left out. Raises
    `InputError` if no frame shows all markers, if they are ambiguous, or if the camera moved.
    """
    tracker = load_kind(marker).tracker(plane, names, layout)
    drift = None if plane.board is None else DriftMonitor(plane, plane.board)
    duplicates = _DuplicateFrames()
    times: list[float] = []
    positions: list[FloatArray] = []
    sizes: list[FloatArray] = []
    last_frame = np.zeros((*plane.size[::-1], 3), np.uint8)
    for t, image in source:
        if not duplicates.is_later(t, image):
            continue
        times.append(t)
        positions.append(tracker.update(image, t))
        sizes.append(tracker.sizes)
        if drift is not None:
            drift.check(image, t)
        last_frame = image
        progress(len(times))
    if not tracker.acquired:
        raise _undetected_error(tracker, len(times), last_frame)
    motion = Trajectory(names, np.array(times), np.array(positions)).bridge()
    unseen = () if drift is None else _describe_unseen_tags(drift.seen_at, times[-1])
    quality = TrackingQuality.of(
        motion,
        np.array(sizes),
        tracker.relative_size_error,
        duplicates.times,
        duplicates.pictures,
        math.nan if drift is None else drift.max_shift,
        (*tracker.notes, *unseen),
    )
    return TrackingResult(motion, quality, last_frame, np.array(sizes))


def _describe_unseen_tags(seen_at: float, end: float) -> tuple[str, ...]:
    """What the reference tags do not tell of a film that ends at `end` [s]; `seen_at`: NaN if never.

    If the tags are later seen in their old places, the camera has not moved in between.
    """
    if math.isnan(seen_at):
        return ("The reference tags were not seen: whether the camera moved is unknown.",)
    if end - seen_at <= _MAX_UNSEEN_TAGS:
        return ()
    return (
        f"The reference tags were last seen at {seen_at:.0f} s: whether the camera moved later is unknown.",
    )


def _undetected_error(tracker: MarkerTracker[Any], frames: int, last_frame: Image) -> InputError:
    """The error for a source that never shows all markers together, with its cause as far as it is known."""
    missing = f"none like {', '.join(tracker.undetected)}"
    found = missing if tracker.undetected else "none that can be on one body together"
    remedy = (
        "uncover them, light them evenly, and for a film without a design give the number of markers with "
        "--marks"
    )
    if last_frame.max(initial=0) < _MIN_BRIGHTNESS:
        remedy = "the pictures are dark: give more light, or a longer exposure"
    elif tracker.is_coloured and np.ptp(last_frame, axis=2).max(initial=0) < _MIN_COLOUR_RANGE:
        remedy = "the pictures have no colours: film in colour, or use numbered squares (marker: aruco)"
    elif tracker.notes:
        found = "; ".join([found, *tracker.notes])
        remedy = tracker.remedy
    return InputError(
        "no frame shows all markers",
        code="marks.not-seen",
        expected=f"{', '.join(tracker.names)} {tracker.appearance} in "
        + (f"one of the {frames} frames" if frames > 1 else "the only frame"),
        found=found,
        remedy=remedy,
    )


def track_log(log: RunLog) -> Trajectory:
    """Track the frames of a log again, with its own tags and design."""
    source = LoggedFrames(log)
    layout = read_attached_layout(source)
    names = tuple(PALETTE)[: None if layout is None else len(layout)]
    return track_frames(
        source,
        find_recorded_plane(source),
        names,
        layout,
        marker=read_marker_kind(source.attachments, source.name),
    ).trajectory


def draw_overlay(
    image: Image, plane: Plane, trajectory: Trajectory, ground: FloatArray | None = None
) -> bytes:
    """A picture (PNG) to check the result: paths of the markers, their names, the table and a scale.
    `ground`: corners of the surface of a printed ground on it [m], shape (K, 2)."""
    picture = cv2.resize(image, None, fx=_ZOOM, fy=_ZOOM, interpolation=cv2.INTER_CUBIC)

    def line(points: FloatArray, colour: tuple[float, ...], width: int) -> None:
        at = np.round((_to_zoomed(plane.to_pixels(points))) * 8).astype(np.int32)
        cv2.polylines(picture, [at], False, colour, width, cv2.LINE_AA, shift=3)

    corners = plane.to_metres(np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) * (np.array(plane.size) - 1.0))
    x = np.linspace(corners[:, 0].min(), corners[:, 0].max(), 100)
    line(np.stack([x, np.zeros_like(x)], axis=1), (255, 255, 255), 1)
    for tenth in range(int(np.ceil(x[0] * 10)), int(x[-1] * 10) + 1):
        line(np.array([[tenth / 10, 0.0], [tenth / 10, -0.008]]), (255, 255, 255), 2)
        position = plane.to_pixels(np.array([tenth / 10, -0.02]))
        _write_text(picture, f"{tenth / 10:.1f} m", position, 0.5)
    if ground is not None:
        draw_ground(picture, _to_zoomed(plane.to_pixels(ground)))
    ends: list[tuple[str, FloatArray]] = []
    for k, name in enumerate(trajectory.names):
        path = trajectory.positions[:, k]
        good = np.isfinite(path[:, 0])
        colour = tuple(nominal_bgr(name))
        for piece in np.split(np.arange(len(path)), np.flatnonzero(np.diff(good.astype(int))) + 1):
            if good[piece[0]]:
                line(path[piece], (0, 0, 0), 4)
                line(path[piece], colour, 2)
        if good.any():
            last_pixel = plane.to_pixels(path[good][-1])
            cv2.drawMarker(
                picture,
                np.round(_to_zoomed(last_pixel)).astype(int).tolist(),
                (255, 255, 255),
                cv2.MARKER_CROSS,
                14,
                1,
            )
            ends.append((name, last_pixel + np.array([7, -5])))
    for name, position in declutter_labels(ends):  # above all paths
        _write_text(picture, name, position, 0.6)
    return cv2.imencode(".png", picture)[1].tobytes()


def declutter_labels(labels: Sequence[tuple[str, FloatArray]]) -> list[tuple[str, FloatArray]]:
    """Labels at pixels (2,), moved down where they would cover another one [px]."""
    placed: list[tuple[str, FloatArray]] = []
    for name, at in sorted(labels, key=lambda label: label[1][1]):
        position = at.copy()
        while any((np.abs(position - other) < _LABEL_SIZE).all() for _, other in placed):
            position[1] += 1.0
        placed.append((name, position))
    return placed


def _to_zoomed(pixels: FloatArray) -> FloatArray:
    return (pixels + 0.5) * _ZOOM - 0.5


def _write_text(picture: Image, text: str, pixel: FloatArray, size: float) -> None:
    at = np.round(_to_zoomed(pixel)).astype(int).tolist()
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, (255, 255, 255), 1, cv2.LINE_AA)


class _DuplicateFrames:
    """Counts duplicates: a camera or a recorder may deliver a frame twice."""

    def __init__(self) -> None:
        self._time = -np.inf
        self._image: Image | None = None
        self.times = 0
        """Frames that were not later than the one before."""
        self.pictures = 0
        """Later frames with exactly the same picture as the one before, which a real sensor never gives."""

    def is_later(self, t: float, image: Image) -> bool:
        """Whether a frame at t [s] is later than the last one; otherwise leave it out."""
        if t <= self._time:
            self.times += 1
            return False
        before, self._image, self._time = self._image, image, t
        self.pictures += before is not None and _equal_pictures(before, image)
        return True


def _equal_pictures(a: Image, b: Image) -> bool:
    return np.array_equal(a[::_COARSE_ROWS], b[::_COARSE_ROWS]) and np.array_equal(a, b)


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
        printed_ground: PrintedGround | None = None,
        lens: Lens | None = None,
    ):
        """`board`: places of the reference tags. `plane`: a calibrated plane, which needs no tags.
        `layout` (K, 2) [m]: where the design has the markers; it also says how many there are.
        `marker`: the kind of marker. `printed_ground`: the ground under the robot; None: a table.
        `lens`: that the pictures' log keeps, for the plane that the tags show."""
        self._kind = load_kind(marker)
        self.names: tuple[str, ...] = tuple(PALETTE)[: None if layout is None else len(layout)]
        self._board, self._lens = board, lens
        self._given_plane = plane
        self._layout = layout
        self._tracker: MarkerTracker[Any] | None = None
        self._buffer: list[tuple[int, Image]] = []
        self._origin_ns: int | None = None
        self._printed_ground, self._is_run = printed_ground, False
        self.ground: FloatArray | None = None
        """Corners of the surface of the printed ground in the plane of motion [m], shape (P, 2); None on a
        table, and while it is not known where the ground lies."""

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

        The tracker counts its time from `origin_ns` [ns], or else from the first picture to come; without a
        start the ground is not looked for.
        """
        self._tracker = self.ground = None
        self._buffer.clear()
        self._origin_ns, self._is_run = origin_ns, origin_ns is not None

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
            images = [image for _, image in self._buffer]
            plane = calibrate_with_recorded_lens(images, self._board, origin, self._lens)
        self._tracker = self._kind.tracker(plane, self.names, self._layout)
        return self._tracker

    def _track_buffer(self, tracker: MarkerTracker[Any]) -> list[tuple[int, FloatArray, Image]]:
        pictures, self._buffer = self._buffer, []
        origin = self._origin_ns = pictures[0][0] if self._origin_ns is None else self._origin_ns
        tracks = []
        for at, image in pictures:
            t = 1e-9 * (at - origin)
            positions = tracker.update(image, t)
            if self._is_run and self._printed_ground is not None and self.ground is None:
                self.ground = self._printed_ground.in_plane(np.array([t]), positions[None])
            tracks.append((at, positions, image))
        return tracks


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

    def draw(self, image: Image, plane: Plane, ground: FloatArray | None = None) -> bytes:
        """PNG of the picture with the paths of the markers, and the ground as in `draw_overlay`."""
        times, positions = zip(*self._trail, strict=True)
        self._last_drawing = times[-1]
        path = Trajectory(self._names, np.array(times), np.array(positions))
        return draw_overlay(image, plane, path, ground)
