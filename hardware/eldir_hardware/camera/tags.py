"""Reference tags in a picture: their corners, found along their edges, and whether the camera has moved."""

from __future__ import annotations

import math

import cv2
import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_hardware.camera.plane import Image, Plane, TagBoard

MIN_TAGS = 4
"""Tags that determine a plane."""
_PROFILE_REACH = 3.0
"""How far to either side of an edge its profile is read [px]; the border of a tag must be wider."""
MAX_DRIFT = 2.0
"""The camera counts as moved if the median shift of the tags is larger than this [px]."""
_CHECK_INTERVAL = 2.0  # [s]
_MIN_SHIFTS = 3
_NO_LINE = (math.nan, math.nan, math.nan)


def require_dictionary(name: str, count: int = 1) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of that name. Raises `InputError` if it does not exist or has fewer than `count`
    tags."""
    number = getattr(cv2.aruco, name, None)
    if not (isinstance(number, int) and name.startswith("DICT_")):
        raise InputError(
            "unknown tag dictionary",
            code="tags.unknown-dictionary",
            expected="such as DICT_4X4_50",
            found=name,
        )
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    if count > len(dictionary.bytesList):
        raise InputError(
            "too many tags",
            code="tags.too-many",
            expected=f"at most {len(dictionary.bytesList)} of {name}",
            found=str(count),
        )
    return dictionary


def locate_tags(image: Image, board: TagBoard) -> dict[int, FloatArray]:
    """Corners (4, 2) [px] of each visible tag of the board, by its number.

    They are the intersections of the tag's edges. OpenCV's own refinements are biased for small tags, because
    a blurred corner is round; edges are not.
    """
    detector = cv2.aruco.ArucoDetector(require_dictionary(board.dictionary))
    grey = _to_grey(image)
    detections: list[tuple[int, FloatArray]] = []
    for scale in (1, 2):  # twice the size finds smaller tags, and misses others
        larger = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        corners, ids, _ = detector.detectMarkers(larger)
        for i, c in zip([] if ids is None else ids.ravel(), corners, strict=False):
            detections.append((int(i), (c[0].astype(np.float64) + 0.5) / scale - 0.5))
    tags = _reject_reflections(detections, board)
    cells = detector.getDictionary().markerSize + 2
    min_diagonal = 1.41 * cells * (_PROFILE_REACH + 0.5)
    large = {i: c for i, c in tags.items() if np.linalg.norm(c[0] - c[2]) > min_diagonal}
    return refine_tags(grey, {i: large[i] for i in board.ids if i in large})


def _to_grey(image: Image) -> Image:
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def _reject_reflections(detections: list[tuple[int, FloatArray]], board: TagBoard) -> dict[int, FloatArray]:
    """One detection of each tag, corners (4, 2) [px]. Of a number that is detected at several places, the
    detection that agrees with the places of the other tags.

    A reflection shows a tag upside down and mirrored; some such pictures read as the same number, rotated.
    """
    if not detections:
        return {}
    tops = np.array([c[1] - c[0] for _, c in detections])
    turns = np.round(np.arctan2(tops[:, 1], tops[:, 0]) / (np.pi / 2)).astype(int) % 4
    usual = np.bincount(turns, minlength=4).argmax()
    upright: dict[int, list[FloatArray]] = {}
    for (i, corners), turn in zip(detections, turns.tolist(), strict=True):
        others = upright.setdefault(i, []) if turn == usual else []
        near = [np.hypot(*(corners - c).mean(axis=0)) < np.linalg.norm(c[0] - c[2]) / 2 for c in others]
        if any(near):
            others[near.index(True)] = corners  # the same tag, measured in the larger copy
        else:
            others.append(corners)
    unique = {i: c[0] for i, c in upright.items() if len(c) == 1}
    rows = {i: k for k, i in enumerate(board.ids)}
    known = [i for i in unique if i in rows]
    if len(unique) == len(upright) or len(known) < MIN_TAGS:
        return unique
    centres = board.centres[[rows[i] for i in known]]
    to_pixels, _ = cv2.findHomography(centres, np.array([unique[i].mean(axis=0) for i in known]))
    for i in set(upright) - set(unique):
        if to_pixels is not None and i in rows:
            expected = cv2.perspectiveTransform(board.centres[rows[i]].reshape(1, 1, 2), to_pixels).ravel()
            unique[i] = min(upright[i], key=lambda c: float(np.hypot(*(c.mean(axis=0) - expected))))
    return unique


def refine_tags(image: Image, corners: dict[int, FloatArray]) -> dict[int, FloatArray]:
    """Corners (4, 2) [px] of tags whose corners are known to a few pixels, as intersections of their edges;
    without the tags of which an edge is not visible."""
    grey = _to_grey(image)
    refined = {i: intersect_edges(grey, c) for i, c in corners.items()}
    return {i: c for i, c in refined.items() if np.isfinite(c).all()}


def intersect_edges(grey: Image, corners: FloatArray, reach: float = _PROFILE_REACH) -> FloatArray:
    """Corners (4, 2) [px] refined as intersections of the lines along the four edges; NaN without an edge.

    `reach`: how far to either side of an edge its profile is read [px], less than the border is wide.
    """
    for _ in range(2):  # the second time, profiles are centred
        lines = [_fit_edge(grey, corners[i], corners[(i + 1) % 4], reach) for i in range(4)]
        refined = np.array([_intersection(lines[i - 1], lines[i]) for i in range(4)])
        if not np.isfinite(refined).all():
            return np.full((4, 2), np.nan)
        corners = refined
    return corners


_Line = tuple[float, float, float]
"""Coefficients of the line l0 x + l1 y + l2 = 0 through points (x, y) [px]."""


def _intersection(one: _Line, other: _Line) -> tuple[float, float]:
    (a, b, c), (p, q, r) = one, other
    w = a * q - b * p
    return ((b * r - c * q) / w, (c * p - a * r) / w) if w else (math.nan, math.nan)


def _fit_edge(grey: Image, a: FloatArray, b: FloatArray, reach: float) -> _Line:
    """Line along the edge from a to b, dark on its right hand."""
    span = b - a
    length = math.hypot(*span)
    along = span / length
    out = np.array([along[1], -along[0]])  # corners run clockwise in the picture, y down
    margin = (reach + 1) / length
    at = np.linspace(margin, 1 - margin, max(8, int(length)))
    offsets = np.linspace(-reach, reach, round(4 * reach) + 1)
    # No (N, 13, 2) of both coordinates: numpy takes several times as long over an axis of two.
    x, y = ((a[d] + at * span[d])[:, None] + offsets * out[d] for d in range(2))
    profile = cv2.remap(grey, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR).astype(np.float64)
    first, second, *_ = profile.T
    *_, last_but_one, last = profile.T
    dark, bright = (first + second) / 2, (last_but_one + last) / 2
    rise = bright - dark
    sharp = rise > 20
    if sharp.sum() < 5:
        return _NO_LINE
    # A step from dark to bright at s has the mean bright + (dark - bright) (s + reach) / (2 reach).
    inner = (profile.sum(axis=1) - (first + last) / 2) / (len(offsets) - 1)
    s = 2 * reach * (bright[sharp] - inner[sharp]) / rise[sharp] - reach
    slope, offset = _fit_line(at[sharp] - 0.5, s)
    middle = (a + b) / 2 + offset * out
    direction = along * length + slope * out
    normal = direction[1], -direction[0]
    return float(normal[0]), float(normal[1]), float(-(normal[0] * middle[0] + normal[1] * middle[1]))


def _fit_line(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope, and value at 0, of the straight line through points (N,) by least squares."""
    mean = x.sum() / len(x)
    from_mean = x - mean
    slope = float(from_mean @ y / (from_mean @ from_mean))
    return slope, float(y.sum() / len(y) - slope * mean)


class DriftMonitor:
    """Compares centres of tags with the calibrated plane; neither ink nor exposure moves a centre."""

    def __init__(self, plane: Plane, board: TagBoard):
        self._board = board
        corners = plane.to_pixels(board.corners)
        self._corners = dict(zip(board.ids, corners, strict=True))
        self._next_check = -np.inf
        self.max_shift = math.nan
        """Greatest median shift of the tags so far [px]; NaN until three of them were seen in a frame."""
        self.seen_at = math.nan
        """Time of the last check that saw three of them [s]; NaN until then."""

    def check(self, image: Image, t: float) -> None:
        """Check a frame taken at t [s], every other second. Raises `InputError` if the camera has moved."""
        if t < self._next_check:
            return
        self._next_check = t + _CHECK_INTERVAL
        shifts = self._shifts(refine_tags(image, self._corners))
        if len(shifts) < len(self._corners) / 2 or max(shifts) > MAX_DRIFT:  # search the whole picture
            shifts = self._shifts(locate_tags(image, self._board))
        if len(shifts) < _MIN_SHIFTS:
            return
        self.seen_at = t
        shift = float(np.median(shifts))
        self.max_shift = float(np.fmax(self.max_shift, shift))
        if shift > MAX_DRIFT:
            raise InputError(
                f"the camera has moved since its plane was calibrated, at {t:.1f} s",
                code="camera.moved",
                expected=f"the reference tags within {MAX_DRIFT:g} px of their positions",
                found=f"{shift:.1f} px",
                remedy="fasten the camera; calibrate the plane again from this recording (--tags)",
            )

    def _shifts(self, corners: dict[int, FloatArray]) -> list[float]:
        """Distance of the centre of each tag from its calibrated place [px]."""
        return [
            float(np.hypot(*(c.mean(axis=0) - self._corners[i].mean(axis=0)))) for i, c in corners.items()
        ]
