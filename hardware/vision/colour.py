"""Colour apart from brightness: where white, grey and black all become nothing.

A pixel is split into its part along the picture's own neutral colour and the rest, its chroma. Shadow,
uneven light and exposure move the first; a coloured mark stands out in the second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.plane import Image
from eldir.core.records import FloatArray
from hardware.images.mark_sheet import nominal_bgr

_SAMPLE = 19_200
"""Number of pixels that determine the neutral colour: every fourth row and column at 640 x 480."""


@dataclass(frozen=True)
class ColourModel:
    """The colours of a picture in which most pixels are grey."""

    neutral: FloatArray
    """Direction of grey in BGR, unit length, shape (3,)."""
    basis: NDArray[np.float32]
    """Matrix from BGR to chroma, shape (2, 3); orthonormal rows, orthogonal to the neutral."""

    @classmethod
    def learn(cls, image: Image) -> ColourModel:
        """The neutral is the median over the picture: walls, paper and robot outweigh the marks."""
        step = max(int(np.sqrt(image.shape[0] * image.shape[1] / _SAMPLE)), 1)
        sample = image[::step, ::step].reshape(-1, 3)
        neutral = np.maximum(np.median(sample, axis=0), 1.0)
        neutral /= np.linalg.norm(neutral)
        first = np.cross(neutral, [0.0, 1.0, 0.0])
        first /= np.linalg.norm(first)
        return cls(neutral, np.stack([first, np.cross(neutral, first)]).astype(np.float32))

    def chroma(self, pixels: NDArray) -> NDArray:
        """Chroma (..., 2) of BGR pixels (..., 3), in grey levels."""
        return pixels.astype(np.float32) @ self.basis.T

    def vividness(self, image: Image) -> NDArray[Any]:
        """Length of the chroma of every pixel, in grey levels, shape (H, W)."""
        return cv2.magnitude(*(cv2.transform(image.astype(np.float32), row[None]) for row in self.basis))

    def hue_of_mark(self, name: str) -> float:
        """Hue that the mark's printed colour should have in this light [rad]."""
        return hue(self.chroma(nominal_bgr(name) * self.neutral * np.sqrt(3)))


def hue(chroma: NDArray) -> float:
    """Angle of a chroma (2,) [rad]."""
    return float(np.arctan2(chroma[1], chroma[0]))


def between_hues(a: float, b: float) -> float:
    """Size of the angle between two hues [rad]."""
    return abs((a - b + np.pi) % (2 * np.pi) - np.pi)
