"""Colour apart from brightness: where white, grey and black all become nothing.

A pixel is split into its part along the picture's own neutral colour and the rest, its chroma. Shadow,
uneven light and exposure move the first; a coloured mark stands out in the second. The neutral is the
colour of the fixed tags' paper, so that a wooden table may fill the picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eldir.core.records import FloatArray
from eldir_hardware.camera.plane import Image
from eldir_hardware.markers.mark_sheet import nominal_bgr

_SAMPLE = 19_200
"""Number of pixels that determine the colours: every fourth row and column at 640 x 480."""
_LEAST_PAPER = 20
"""Number of pixels of paper that are neither black nor saturated, for a neutral from them alone."""
_COLOURED = 12.0
"""Chroma above which a pixel of the background counts as coloured, in grey levels."""
_SECTORS = 24
"""Number of hues in which coloured surfaces are looked for."""
_SURFACE = 0.02
"""Part of the picture that a coloured surface fills. Five marks fill less than a third of that."""
_FARTHEST = 98.0
"""Percentile of the chroma in a sector that stands for the surface's strongest colour."""


@dataclass(frozen=True)
class ColourModel:
    """The colours of a picture: its grey, and those of the surfaces behind the marks."""

    neutral: FloatArray
    """Direction of grey in BGR, unit length, shape (3,)."""
    basis: NDArray[np.float32]
    """Matrix from BGR to chroma, shape (2, 3); orthonormal rows, orthogonal to the neutral."""
    surfaces: FloatArray
    """Strongest chroma of each hue that fills a part of the picture, in grey levels, shape (J, 2)."""
    shares: FloatArray
    """Part of the picture that each of these hues fills, shape (J,)."""

    @classmethod
    def learn(cls, image: Image, paper: FloatArray | None = None) -> ColourModel:
        """The neutral is the colour of white `paper` at these pixels (N, 2).

        Without them it is the median over the picture, which walls and robot determine if no more than half
        of it is coloured.
        """
        step = max(int(np.sqrt(image.shape[0] * image.shape[1] / _SAMPLE)), 1)
        sample = image[::step, ::step].reshape(-1, 3)
        white = sample if paper is None else _white(image, paper)
        neutral = np.maximum(np.median(white if len(white) else sample, axis=0), 1.0)
        neutral /= np.linalg.norm(neutral)
        first = np.cross(neutral, [0.0, 1.0, 0.0])
        first /= np.linalg.norm(first)
        basis = np.stack([first, np.cross(neutral, first)]).astype(np.float32)
        return cls(neutral, basis, *_surfaces(sample @ basis.T))

    def chroma(self, pixels: NDArray) -> NDArray:
        """Chroma (..., 2) of BGR pixels (..., 3), in grey levels."""
        return pixels.astype(np.float32) @ self.basis.T

    def vividness(self, image: Image) -> NDArray[Any]:
        """Length of the chroma of every pixel, in grey levels, shape (H, W)."""
        return cv2.magnitude(*(cv2.transform(image.astype(np.float32), row[None]) for row in self.basis))

    def contrast(self, image: Image) -> NDArray[Any]:
        """Distance of every pixel's chroma from what grey and coloured surfaces show in light and shade, in
        grey levels, shape (H, W)."""
        a, b = (cv2.transform(image.astype(np.float32), row[None]) for row in self.basis)
        least = cv2.magnitude(a, b)
        for surface in self.surfaces:
            length = float(np.hypot(*surface))
            u, v = (surface / length).tolist()
            along = np.clip(u * a + v * b, 0, length)  # shade and mixture with grey lie on this line
            least = np.minimum(least, cv2.magnitude(a - u * along, b - v * along))
        return least

    def share_of_hue(self, name: str, within: float) -> float:
        """Part of the picture that coloured surfaces with a mark's hue fill, to `within` [rad]."""
        hues = np.arctan2(self.surfaces[:, 1], self.surfaces[:, 0]).tolist()
        alike = [between_hues(h, self.hue_of_mark(name)) < within for h in hues]
        return float(self.shares[alike].sum())

    def hue_of_mark(self, name: str) -> float:
        """Hue that the mark's printed colour should have in this light [rad]."""
        return hue(self.chroma(nominal_bgr(name) * self.neutral * np.sqrt(3)))


def _white(image: Image, paper: FloatArray) -> NDArray[Any]:
    """Pixels (M, 3) of paper within the picture: neither saturated nor covered, where there are enough."""
    x, y = np.round(paper).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
    seen = image[y[inside], x[inside]].astype(np.float64)
    brightness = seen.min(axis=1)
    good = seen[(seen.max(axis=1) < 250) & (brightness > 0.7 * np.median(brightness))] if len(seen) else seen
    return good if len(good) >= _LEAST_PAPER else seen


def _surfaces(chroma: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
    """Coloured surfaces in a sample of chroma (N, 2): the strongest chroma of each (J, 2), its share (J,)."""
    length = np.hypot(chroma[:, 0], chroma[:, 1])
    turns = np.arctan2(chroma[:, 1], chroma[:, 0]) / (2 * np.pi) % 1.0
    sector = np.where(length > _COLOURED, (turns * _SECTORS).astype(int) % _SECTORS, -1)
    found, shares = [], []
    for k in range(_SECTORS):
        own = sector == k
        share = float(own.mean())
        if share > _SURFACE:
            mean = chroma[own].mean(axis=0)
            found.append(mean / np.hypot(*mean) * np.percentile(length[own], _FARTHEST))
            shares.append(share)
    return np.array(found, np.float64).reshape(-1, 2), np.array(shares, np.float64)


def hue(chroma: NDArray) -> float:
    """Angle of a chroma (2,) [rad]."""
    return float(np.arctan2(chroma[1], chroma[0]))


def between_hues(a: float, b: float) -> float:
    """Size of the angle between two hues [rad]."""
    return abs((a - b + np.pi) % (2 * np.pi) - np.pi)
