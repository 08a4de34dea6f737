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
from eldir_hardware.images.video import draw_body, encode_webm, scaled
from eldir_hardware.log.reader import RunLog

PICTURES = 80
"""Of the film at most."""
RATE = 10.0
"""Of the film [pictures/s]."""
LARGEST = 500_000
"""Of the film [bytes]; a larger one is made of smaller pictures."""
_WIDTHS = (480, 360, 270)  # [px]
_MARGIN = 0.12  # around the robot, of the larger side
_LEAST = 64  # of a side [px]


class PredictedBody(NamedTuple):
    """The predicted motion of a whole robot."""

    times: FloatArray
    """Times [s since the start of the schedule], shape (T,)."""
    positions: FloatArray
    """Places of all masses in the plane [m], shape (T, M, 2)."""
    springs: IntArray
    """The two masses of each spring, shape (S, 2)."""
    marks: IntArray
    """The marked masses, shape (K,)."""


def film_of(log: RunLog, plane: Plane, filmed: Motion, body: PredictedBody) -> bytes:
    """WebM of the cycles that count, cut to where the robot is. The predicted body is moved sideways so that
    its marks stand where the filmed ones do when these cycles begin; from then on its walk is its own."""
    begin, end = filmed.start, filmed.start + filmed.cycles * filmed.period
    chosen = _pictures(log, begin, end)
    ahead = _ahead(filmed, body, begin)
    places = [plane.to_pixels(_at(body, t) + np.array([ahead, 0.0])) for t, _ in chosen]
    marks = plane.to_pixels(filmed.trajectory.positions.reshape(-1, 2))
    cut = _cut(np.concatenate([*places, marks]), plane.size)
    film = b""
    for width in _WIDTHS:
        film = encode_webm(_drawn(chosen, places, cut, filmed, body.springs, width), RATE)
        if len(film) <= LARGEST:
            break
    return film


def _pictures(log: RunLog, begin: float, end: float) -> list[tuple[float, NDArray[np.uint8]]]:
    """Time [s] and JPEG of the pictures that come first in each of `PICTURES` equal parts of the time."""
    found: dict[int, tuple[float, NDArray[np.uint8]]] = {}
    for stamp, data in log.pictures:
        t = (stamp - log.epoch_ns) * 1e-9
        if begin <= t < end:
            found.setdefault(int(PICTURES * (t - begin) / (end - begin)), (t, data))
    return list(found.values())


def _ahead(filmed: Motion, body: PredictedBody, t: float) -> float:
    """How far the filmed marks are before the predicted ones at `t` [m]."""
    path = filmed.trajectory
    seen = np.array([np.interp(t, path.times, path.positions[:, k, 0]) for k in range(len(path.names))])
    apart = seen - _at(body, t)[body.marks[: len(path.names)], 0]
    return float(np.nanmean(apart)) if np.isfinite(apart).any() else 0.0


def _at(body: PredictedBody, t: float) -> FloatArray:
    """Places of all masses at `t` [s], the nearest instant's."""
    return body.positions[int(np.abs(body.times - t).argmin())]


def _cut(pixels: FloatArray, size: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a picture of that size that hold all pixels (N, 2), with a margin."""
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = _MARGIN * max(high - low)
    first = np.clip(np.floor(low - margin), 0, np.array(size) - _LEAST).astype(int)
    last = np.clip(np.ceil(high + margin), first + _LEAST, size).astype(int)
    return slice(first[1], last[1]), slice(first[0], last[0])


def _drawn(
    chosen: list[tuple[float, NDArray[np.uint8]]],
    places: list[FloatArray],
    cut: tuple[slice, slice],
    filmed: Motion,
    springs: IntArray,
    width: int,
) -> Iterator[NDArray[np.uint8]]:
    """The pictures of the film, RGB."""
    corner = np.array([cut[1].start, cut[0].start])
    for (t, data), pixels in zip(chosen, places, strict=True):
        picture, scale = scaled(jpeg.decode(data)[cut], width)
        cycle = min(int((t - filmed.start) / filmed.period), filmed.cycles - 1) + 1
        draw_body(picture, scale * (pixels - corner), springs, f"{t:.0f} s, cycle {cycle} of {filmed.cycles}")
        yield picture[..., ::-1]
