"""A picture every few seconds that shows whether live tracking works: the latest paths over the picture."""

from __future__ import annotations

from collections import deque

import numpy as np

from eldir.core.records import FloatArray
from eldir.trajectory import Trajectory
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.vision.pipeline import overlay

_TRAIL = 600  # the overlay shows at most so many positions of each mark


class LiveOverlay:
    """Collects positions, and draws them at most once in `period` seconds."""

    def __init__(self, names: tuple[str, ...]):
        self._names = names
        self._trail: deque[tuple[float, FloatArray]] = deque(maxlen=_TRAIL)
        self._drawn = -np.inf

    def add(self, t: float, positions: FloatArray) -> None:
        """Positions (K, 2) [m] of the marks at `t` [s]; NaN where a mark was not seen."""
        self._trail.append((t, positions))

    def is_due(self, t: float, period: float) -> bool:
        """Whether the last drawing is `period` [s] old."""
        return t - self._drawn >= period

    def draw(self, image: Image, plane: Plane) -> bytes:
        """PNG of the picture with the paths of the marks."""
        times, positions = zip(*self._trail, strict=True)
        self._drawn = times[-1]
        return overlay(image, plane, Trajectory(self._names, np.array(times), np.array(positions)))
