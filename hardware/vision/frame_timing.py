"""Detects frames that a camera or a recorder delivered twice."""

from __future__ import annotations

import numpy as np

from calibration.camera.plane import Image

_COARSE = 24
"""Only every n-th row is compared first; this distinguishes most pictures."""


class Repetitions:
    """Compares every frame with the one before."""

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
        self.pictures += before is not None and _same(before, image)
        return True


def _same(a: Image, b: Image) -> bool:
    return np.array_equal(a[::_COARSE], b[::_COARSE]) and np.array_equal(a, b)
