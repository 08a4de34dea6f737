"""Frames that a camera or a recorder gave twice."""

from __future__ import annotations

import numpy as np

from calibration.camera.plane import Image

_COARSE = 24
"""Every so many rows are compared first: they tell most pictures apart."""


class Repetitions:
    """Compares every frame with the one before."""

    def __init__(self) -> None:
        self._time = -np.inf
        self._image: Image | None = None
        self.times = 0
        """Frames that were not later than the one before."""
        self.pictures = 0
        """Frames that were later, with the very picture of the one before: sensors are never so quiet."""

    def is_later(self, t: float, image: Image) -> bool:
        """Whether a frame at t [s] is later than the last one; False is for leaving it out."""
        if t <= self._time:
            self.times += 1
            return False
        before, self._image, self._time = self._image, image, t
        self.pictures += before is not None and _same(before, image)
        return True


def _same(a: Image, b: Image) -> bool:
    return np.array_equal(a[::_COARSE], b[::_COARSE]) and np.array_equal(a, b)
