"""Numbered squares, for where colours cannot be used: ArUco and AprilTag, each with its own number.

A disc of the same size is measured several times better (docs/reference/vision.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import cv2
import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir.errors import InputError
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.camera.tags import cross_edges
from eldir_hardware.markers.painted_squares import paint_square, square_cells
from eldir_hardware.markers.registration import MarkerKind
from eldir_hardware.markers.tracker import MarkerTracker

FIRST = 40
"""m1 is number 40, m2 is 41, ...: the reference tags must use others."""
SIDE = 0.024
"""Side of the black square [m]: masses are 40 mm apart or more."""
_REACH, _MAX_REACH = 0.6, 3.0
"""How far to either side of an edge its profile is read: in cells, and at most [px]."""
_MAX_CORRECTION = 3.0
"""A corner that moves farther when it is located along the edges was not one [px]."""


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
        numbers = set(range(FIRST, FIRST + len(names)))
        if tags is not None and tags.dictionary == self.dictionary and numbers & set(tags.ids):
            raise InputError(
                "a reference tag has the number of a marker",
                expected=f"no tag of {self.dictionary} with a number from {FIRST} to {max(numbers)}",
                found=", ".join(map(str, sorted(numbers & set(tags.ids)))),
                remedy="print these reference tags with other numbers",
            )
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        self._detector = cv2.aruco.ArucoDetector(dictionary, parameters)

    def _detect(self, frame: Image) -> tuple[list[Square], BoolArray, FloatArray]:
        grey: Image = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        wanted = set(range(FIRST, FIRST + len(self.names)))
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
        fine = cross_edges(grey, rough, min(_MAX_REACH, _REACH * cell))
        good = np.isfinite(fine).all() and np.abs(fine - rough).max() < _MAX_CORRECTION
        corners = fine if good else rough
        centre = self.plane.to_pixels(_crossing(self.plane.to_metres(corners)))
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


def _crossing(square: FloatArray) -> FloatArray:
    """Crossing of the diagonals of corners (4, 2): the projected centre of the square."""
    (a, b, c, d) = np.column_stack([square, np.ones(4)])
    x = np.cross(np.cross(a, c), np.cross(b, d))
    return x[:2] / x[2]


def _paint(dictionary: str, name: str, points: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    cells = square_cells(dictionary, FIRST + int(name[1:]) - 1)
    return paint_square(cells, SIDE, SIDE / len(cells), points, width)


ARUCO = MarkerKind(
    ArucoTracker, partial(_paint, ArucoTracker.dictionary), SIDE * 8 / 6, "ArUco squares, DICT_4X4_50"
)
APRILTAG = MarkerKind(
    AprilTagTracker, partial(_paint, AprilTagTracker.dictionary), SIDE * 10 / 8, "AprilTags, 36h11"
)
