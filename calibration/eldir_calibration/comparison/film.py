"""A short film of a run: the camera's pictures, and over them the predicted body."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.core.records import FloatArray, IntArray
from eldir_calibration.report.comparison import Motion
from eldir_hardware.camera.plane import Plane
from eldir_hardware.images import jpeg
from eldir_hardware.images.video import draw_body, draw_ground, encode_webm, resize_to_width
from eldir_hardware.log.reader import RunLog
from eldir_hardware.vision.printed_ground import SETTLED_S, start_offset

MAX_PICTURES = 80
"""Maximum number of pictures in the film."""
FRAME_RATE = 10.0
"""Frame rate of the film [1/s]."""
MAX_SIZE = 500_000
"""Maximum size of the film [bytes]; a larger film is made again with smaller pictures."""
_WIDTHS = (480, 360, 270)  # [px]
_CROP_MARGIN = 0.12  # around the robot, of the larger side
_MIN_SIDE = 64  # of the cropped picture [px]


class PredictedBody(NamedTuple):
    """The predicted motion of a whole robot."""

    times: FloatArray
    """Times [s since the start of the schedule], shape (T,)."""
    positions: FloatArray
    """Places of all masses in the plane [m], shape (T, M, 2)."""
    springs: IntArray
    """The two masses of each spring, shape (S, 2)."""
    marker_masses: IntArray
    """The marked masses, shape (K,)."""
    ground: FloatArray | None = None
    """Corners of the surface of the printed ground, x and height [m], shape (P, 2); None: a table."""


def render_film(log: RunLog, plane: Plane, filmed: Motion, body: PredictedBody) -> bytes:
    """WebM of the cycles that count, cut to where the robot is. The predicted body is moved sideways so that
    its markers stand where the filmed ones do when these cycles begin; from then on its walk is its own. On a
    printed ground both are where `ground_in_film` has the ground."""
    begin, end = filmed.start, filmed.start + filmed.cycles * filmed.period
    pictures = _select_pictures(log, begin, end)
    ground = ground_in_film(filmed, body)
    start = None if ground is None else _start_offset(filmed, body)
    offset = np.array([_forward_offset(filmed, body, begin), 0.0]) if start is None else start
    bodies = [plane.to_pixels(positions_at(body, t) + offset) for t, _ in pictures]
    markers = plane.to_pixels(filmed.trajectory.positions.reshape(-1, 2))
    crop = _crop(np.concatenate([*bodies, markers]), plane.size)
    line = None if ground is None else plane.to_pixels(ground)
    film = b""
    for width in _WIDTHS:
        drawn = _draw_pictures(pictures, bodies, crop, filmed, body.springs, width, line)
        film = encode_webm(drawn, FRAME_RATE)
        if len(film) <= MAX_SIZE:
            break
    return film


def _select_pictures(log: RunLog, begin: float, end: float) -> list[tuple[float, NDArray[np.uint8]]]:
    """Time [s] and JPEG of the pictures that come first in each of `MAX_PICTURES` equal parts of the time."""
    found: dict[int, tuple[float, NDArray[np.uint8]]] = {}
    for stamp, data in log.pictures:
        t = (stamp - log.epoch_ns) * 1e-9
        if begin <= t < end:
            found.setdefault(int(MAX_PICTURES * (t - begin) / (end - begin)), (t, data))
    return list(found.values())


def ground_in_film(filmed: Motion, body: PredictedBody) -> FloatArray | None:
    """Surface of the printed ground in the plane of motion: x and height [m], shape (P, 2); None: a table, or
    it is not known where the ground lies (`eldir_hardware.vision.printed_ground`)."""
    offset = None if body.ground is None else _start_offset(filmed, body)
    return None if body.ground is None or offset is None else body.ground + offset


def _start_offset(filmed: Motion, body: PredictedBody) -> FloatArray | None:
    markers = positions_at(body, SETTLED_S)[body.marker_masses]
    return start_offset(filmed.trajectory.times, filmed.trajectory.positions, markers)


def _forward_offset(filmed: Motion, body: PredictedBody, t: float) -> float:
    """How far the filmed markers are ahead of the predicted ones at `t` [m]."""
    path = filmed.trajectory
    seen = np.array([np.interp(t, path.times, path.positions[:, k, 0]) for k in range(len(path.names))])
    offsets = seen - positions_at(body, t)[body.marker_masses[: len(path.names)], 0]
    return float(np.nanmean(offsets)) if np.isfinite(offsets).any() else 0.0


def positions_at(body: PredictedBody, t: float) -> FloatArray:
    """Places of all masses at `t` [s], the nearest instant's."""
    return body.positions[int(np.abs(body.times - t).argmin())]


def _crop(pixels: FloatArray, size: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a picture of that size that hold all pixels (N, 2), with a margin."""
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = _CROP_MARGIN * max(high - low)
    first = np.clip(np.floor(low - margin), 0, np.array(size) - _MIN_SIDE).astype(int)
    last = np.clip(np.ceil(high + margin), first + _MIN_SIDE, size).astype(int)
    return slice(first[1], last[1]), slice(first[0], last[0])


def _draw_pictures(
    pictures: list[tuple[float, NDArray[np.uint8]]],
    bodies: list[FloatArray],
    crop: tuple[slice, slice],
    filmed: Motion,
    springs: IntArray,
    width: int,
    ground: FloatArray | None,
) -> Iterator[NDArray[np.uint8]]:
    """The pictures of the film, RGB."""
    corner = np.array([crop[1].start, crop[0].start])
    for (t, data), pixels in zip(pictures, bodies, strict=True):
        picture, scale = resize_to_width(jpeg.decode(data)[crop], width)
        cycle = min(int((t - filmed.start) / filmed.period), filmed.cycles - 1) + 1
        if ground is not None:
            draw_ground(picture, scale * (ground - corner))
        draw_body(picture, scale * (pixels - corner), springs, f"{t:.0f} s, cycle {cycle} of {filmed.cycles}")
        yield picture[..., ::-1]
