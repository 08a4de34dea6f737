"""ArUco marks on masses, if colours cannot be used: each mark carries its own number.

A disc of the same size is measured several times better (docs/reference/vision.md).
"""

from __future__ import annotations

import cv2
import numpy as np

from calibration.camera.plane import Image, Plane
from calibration.camera.tags import cross_edges
from eldir.core.records import FloatArray

DICTIONARY = "DICT_4X4_50"
FIRST = 40
"""m1 is number 40, m2 is 41, ...: the fixed tags must use others."""
_SPEED, _JUMP = 1.0, 0.03  # as of discs [m/s], [m]


class ArucoTracker:
    """Follows numbered square marks; used like a `Tracker`."""

    def __init__(self, plane: Plane, names: tuple[str, ...]):
        self.plane = plane
        self.names = names
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
        self._detector = cv2.aruco.ArucoDetector(dictionary, parameters)
        self._last: dict[int, tuple[float, FloatArray]] = {}
        self._first_sizes = np.full(len(names), np.nan)
        self.sizes: FloatArray = np.full(len(names), np.nan)
        """Apparent size of each mark in the last frame, relative to its first size, shape (K,)."""
        self.acquired = False
        self.unseen: tuple[str, ...] = names

    def update(self, frame: Image, t: float) -> FloatArray:
        """Positions (K, 2) [m] of the marks in a frame taken at t [s]; NaN where not seen."""
        self.plane.require_size(frame.shape[1], frame.shape[0])
        grey: Image = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        corners, ids, _ = self._detector.detectMarkers(grey)
        found = dict(zip([] if ids is None else ids.ravel().tolist(), corners, strict=True))
        places = np.full((len(self.names), 2), np.nan)
        sizes = np.full(len(self.names), np.nan)
        for k in range(len(self.names)):
            if FIRST + k not in found:
                continue
            rough = found[FIRST + k][0].astype(np.float64)
            fine = cross_edges(grey, rough)
            square = self.plane.to_metres(fine if np.isfinite(fine).all() else rough)
            place = _crossing(square)
            before, there = self._last.get(k, (t, place))
            if np.hypot(*(place - there)) > _JUMP + _SPEED * (t - before):
                continue  # a number misread elsewhere
            self._last[k] = (t, place)
            places[k] = place
            sizes[k] = np.linalg.norm(square - np.roll(square, 1, axis=0), axis=1).mean()
        self.unseen = tuple(n for k, n in enumerate(self.names) if k not in self._last)
        self.acquired = not self.unseen
        self._first_sizes = np.where(np.isnan(self._first_sizes), sizes, self._first_sizes)
        self.sizes = sizes / self._first_sizes
        return places


def _crossing(square: FloatArray) -> FloatArray:
    """Crossing of the diagonals of corners (4, 2): the projected centre of the square."""
    (a, b, c, d) = np.column_stack([square, np.ones(4)])
    x = np.cross(np.cross(a, c), np.cross(b, d))
    return x[:2] / x[2]
