"""Numbered squares, ArUco and AprilTag: how they are printed, and how those on the masses are tracked.

They are for places where colours cannot be used. A disc of the same size is measured several times better
(docs/reference/vision.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import ClassVar

import cv2
import numpy as np

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.errors import InputError
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.camera.tags import intersect_edges
from eldir_hardware.markers.registration import MarkerKind
from eldir_hardware.markers.tracker import MarkerTracker

_PAPER, _INK = 0.85, 0.05
"""Linear reflectance of paper and ink."""
FIRST_NUMBER = 40
"""m1 is number 40, m2 is 41, ...: the reference tags must use others."""
SQUARE_SIDE = 0.024
"""Side of the black square [m]: the distance of two masses is at least 40 mm."""
_PROFILE_REACH, _MAX_PROFILE_REACH = 0.6, 3.0
"""How far to either side of an edge its profile is read: in cells, and at most [px]."""
_MAX_CORRECTION = 3.0
"""A corner that moves farther when it is located along the edges was not one [px]."""


@lru_cache
def square_cells(dictionary: str, number: int) -> Image:
    """The cells of a square with its black border (N, N), 0 and 255, in OpenCV's dictionary of that name."""
    tags = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    return cv2.aruco.generateImageMarker(tags, number, tags.markerSize + 2)


def paint_square(
    cells: Image, side: float, border: float, points: FloatArray, width: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A square of this side on white paper that is wider by `border` on each side [m].

    At points (..., 2) from its centre [m], each as wide as `width` (...) [m]: the part that the paper covers
    (...), and its linear reflectance (..., 1). Soft edges keep their places exact.
    """
    x, y = points[..., 0], -points[..., 1]
    half = side / 2 + border
    cover = _covered_fraction(x, -half, half, width) * _covered_fraction(y, -half, half, width)
    column, right = _nearest_line(x, side, len(cells), width)
    row, below = _nearest_line(y, side, len(cells), width)
    black = np.pad(np.where(cells == 0, 1.0, 0.0), 1).ravel()
    at, beyond = row * (len(cells) + 2) + column, len(cells) + 2
    above = black[at] + right * (black[at + 1] - black[at])
    under = black[at + beyond] + right * (black[at + beyond + 1] - black[at + beyond])
    return cover, (_PAPER + (above + below * (under - above)) * (_INK - _PAPER))[..., None]


def _covered_fraction(x: FloatArray, low: float, high: float, width: float | FloatArray) -> FloatArray:
    """Part of a point at x that lies between two lines."""
    return np.clip((x - low) / width + 0.5, 0, 1) - np.clip((x - high) / width + 0.5, 0, 1)


def _nearest_line(
    x: FloatArray, side: float, cells: int, width: float | FloatArray
) -> tuple[IntArray, FloatArray]:
    """The line between cells that is nearest to x, 0 at the square's edge, and the part of a point at x that
    lies behind it. A point is narrower than a cell."""
    cell = side / cells
    line = np.clip(np.rint(x / cell + cells / 2), 0, cells)
    behind = np.clip((x - (line - cells / 2) * cell) / np.minimum(width, cell) + 0.5, 0, 1)
    return line.astype(np.intp), behind


@dataclass(frozen=True)
class Square:
    """A numbered square in a picture."""

    number: int
    centre: FloatArray
    """Projection of its centre [px], shape (2,)."""
    size: float
    """Mean side [px]."""


class SquareTracker(MarkerTracker[Square]):
    """Follows numbered squares of one dictionary."""

    appearance = "as numbered squares"
    dictionary: ClassVar[str]
    """OpenCV's name of the dictionary."""

    def __init__(self, plane: Plane, names: tuple[str, ...], layout: FloatArray | None = None):
        """As `MarkerTracker`. Raises `InputError` if the reference tags have the same numbers."""
        super().__init__(plane, names, layout)
        tags = plane.board
        numbers = set(range(FIRST_NUMBER, FIRST_NUMBER + len(names)))
        if tags is not None and tags.dictionary == self.dictionary and numbers & set(tags.ids):
            raise InputError(
                "a reference tag has the number of a marker",
                expected=f"no tag of {self.dictionary} with a number from {FIRST_NUMBER} to {max(numbers)}",
                found=", ".join(map(str, sorted(numbers & set(tags.ids)))),
                remedy="print these reference tags with other numbers",
            )
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        self._detector = cv2.aruco.ArucoDetector(dictionary, parameters)

    def _detect(self, frame: Image) -> tuple[list[Square], BoolArray, FloatArray]:
        grey: Image = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        wanted = set(range(FIRST_NUMBER, FIRST_NUMBER + len(self.names)))
        squares: list[Square] = []
        for scale in (1, 2):  # twice the size finds smaller ones
            missing = wanted - {square.number for square in squares}
            if not missing:
                break
            larger = grey if scale == 1 else cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
            corners, ids, _ = self._detector.detectMarkers(larger)
            squares += [
                self._measure(grey, int(number), (quad[0].astype(np.float64) + 0.5) / scale - 0.5)
                for number, quad in zip([] if ids is None else ids.ravel(), corners, strict=True)
                if int(number) in missing
            ]
        numbers = np.array([square.number for square in squares], int)
        allowed = np.array(sorted(wanted))[:, None] == numbers
        return squares, allowed, np.zeros(allowed.shape)

    def _measure(self, grey: Image, number: int, rough: FloatArray) -> Square:
        """The square with these corners (4, 2) [px], measured along its edges."""
        cells = self._detector.getDictionary().markerSize + 2
        cell = float(np.linalg.norm(rough - np.roll(rough, 1, axis=0), axis=1).mean()) / cells
        fine = intersect_edges(grey, rough, min(_MAX_PROFILE_REACH, _PROFILE_REACH * cell))
        good = np.isfinite(fine).all() and np.abs(fine - rough).max() < _MAX_CORRECTION
        corners = fine if good else rough
        centre = self.plane.to_pixels(_diagonal_intersection(self.plane.to_metres(corners)))
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
        return Square(number, centre, float(sides.mean()))

    def _confirm(self, frame: Image, k: int, candidate: Square) -> Square | None:
        return candidate


class ArucoTracker(SquareTracker):
    """Follows ArUco markers."""

    dictionary = "DICT_4X4_50"


class AprilTagTracker(SquareTracker):
    """Follows AprilTags."""

    dictionary = "DICT_APRILTAG_36h11"


def _diagonal_intersection(square: FloatArray) -> FloatArray:
    """Crossing of the diagonals of corners (4, 2): the projected centre of the square."""
    (a, b, c, d) = np.column_stack([square, np.ones(4)])
    x = np.cross(np.cross(a, c), np.cross(b, d))
    return x[:2] / x[2]


def _paint_marker(
    dictionary: str, name: str, points: FloatArray, width: float
) -> tuple[FloatArray, FloatArray]:
    cells = square_cells(dictionary, FIRST_NUMBER + int(name[1:]) - 1)
    return paint_square(cells, SQUARE_SIDE, SQUARE_SIDE / len(cells), points, width)


ARUCO = MarkerKind(
    ArucoTracker,
    partial(_paint_marker, ArucoTracker.dictionary),
    SQUARE_SIDE * 8 / 6,
    "ArUco squares, DICT_4X4_50",
)
APRILTAG = MarkerKind(
    AprilTagTracker,
    partial(_paint_marker, AprilTagTracker.dictionary),
    SQUARE_SIDE * 10 / 8,
    "AprilTags, 36h11",
)
