"""Measures one coloured disc to a small part of a pixel, by its chroma.

A pixel is split into its part along the picture's neutral colour and the rest, its chroma. Shadow, uneven
light and exposure change the first; a coloured marker stands out in the second. The neutral colour is that
of the reference tags' paper, so that a wooden table may fill the picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot, sqrt
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eldir.core.records import BoolArray, FloatArray
from eldir_hardware.camera.plane import Image
from eldir_hardware.markers.registration import nominal_bgr

_SAMPLE_PIXELS = 19_200
"""Number of pixels that determine the colours: every fourth row and column at 640 x 480."""
_MIN_PAPER_PIXELS = 20
"""Number of pixels of paper that are neither black nor saturated, for a neutral from them alone."""
_MIN_CHROMA = 12.0
"""Chroma above which a pixel of the background counts as coloured, in grey levels."""
_HUE_SECTORS = 24
"""Number of hue sectors that are searched for coloured surfaces."""
_MIN_SURFACE_SHARE = 0.02
"""Part of the picture that a coloured surface fills. Five markers fill less than a third of that."""
_SURFACE_PERCENTILE = 98.0
"""Percentile of the chroma in a sector that stands for the surface's strongest colour."""
_BLUR_MARGIN = 2.5
"""Width of the blurred margin around the disc that still counts [px]."""
_WEIGHT_FLOOR = 0.1
"""Part of the disc's strength that is subtracted from every weight: noise and tinted background."""
_CHROMA_NOISE = 8.0
"""Chroma of noise and of a grey surface's tints, root mean square in grey levels. Where what surrounds the
disc has more, it counts as coloured."""
_EDGE_WIDTH = 2.4
"""Width over which a blurred edge falls from disc to background [px]."""
_CONVERGENCE = 0.05
"""A centre that moves less is found: the next step is a tenth as long or shorter [px]."""


@dataclass(frozen=True)
class ColourModel:
    """The colours of a picture: its grey, and those of the surfaces behind the markers."""

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
        step = max(int(np.sqrt(image.shape[0] * image.shape[1] / _SAMPLE_PIXELS)), 1)
        sample = image[::step, ::step].reshape(-1, 3)
        white = sample if paper is None else _paper_pixels(image, paper)
        neutral = np.maximum(np.median(white if len(white) else sample, axis=0), 1.0)
        neutral /= np.linalg.norm(neutral)
        first = np.cross(neutral, [0.0, 1.0, 0.0])
        first /= np.linalg.norm(first)
        basis = np.stack([first, np.cross(neutral, first)]).astype(np.float32)
        return cls(neutral, basis, *_coloured_surfaces(sample @ basis.T))

    def to_chroma(self, pixels: NDArray) -> NDArray:
        """Chroma (..., 2) of BGR pixels (..., 3), in grey levels."""
        return pixels.astype(np.float32) @ self.basis.T

    def chroma_magnitude(self, image: Image) -> NDArray[Any]:
        """Length of the chroma of every pixel, in grey levels, shape (H, W)."""
        return cv2.magnitude(*(cv2.transform(image.astype(np.float32), row[None]) for row in self.basis))

    def chroma_contrast(self, image: Image) -> NDArray[Any]:
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

    def hue_share(self, name: str, within: float) -> float:
        """Part of the picture that coloured surfaces with a marker's hue fill, to `within` [rad]."""
        hues = np.arctan2(self.surfaces[:, 1], self.surfaces[:, 0]).tolist()
        alike = [hue_difference(h, self.marker_hue(name)) < within for h in hues]
        return float(self.shares[alike].sum())

    def marker_hue(self, name: str) -> float:
        """Hue that the marker's printed colour should have in this light [rad]."""
        return hue_angle(self.to_chroma(nominal_bgr(name) * self.neutral * np.sqrt(3)))


def _paper_pixels(image: Image, paper: FloatArray) -> NDArray[Any]:
    """Pixels (M, 3) of paper within the picture: neither saturated nor covered, where there are enough."""
    x, y = np.round(paper).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
    visible = image[y[inside], x[inside]].astype(np.float64)
    brightness = visible.min(axis=1)
    good = (
        visible[(visible.max(axis=1) < 250) & (brightness > 0.7 * np.median(brightness))]
        if len(visible)
        else visible
    )
    return good if len(good) >= _MIN_PAPER_PIXELS else visible


def _coloured_surfaces(chroma: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
    """Coloured surfaces in a sample of chroma (N, 2): the strongest chroma of each (J, 2), its share (J,)."""
    length = np.hypot(chroma[:, 0], chroma[:, 1])
    turns = np.arctan2(chroma[:, 1], chroma[:, 0]) / (2 * np.pi) % 1.0
    sector = np.where(length > _MIN_CHROMA, (turns * _HUE_SECTORS).astype(int) % _HUE_SECTORS, -1)
    surfaces, shares = [], []
    for k in range(_HUE_SECTORS):
        own = sector == k
        share = float(own.mean())
        if share > _MIN_SURFACE_SHARE:
            mean = chroma[own].mean(axis=0)
            surfaces.append(mean / np.hypot(*mean) * np.percentile(length[own], _SURFACE_PERCENTILE))
            shares.append(share)
    return np.array(surfaces, np.float64).reshape(-1, 2), np.array(shares, np.float64)


def hue_angle(chroma: NDArray) -> float:
    """Angle of a chroma (2,) [rad]."""
    return float(np.arctan2(chroma[1], chroma[0]))


def hue_difference(a: float, b: float) -> float:
    """Size of the angle between two hues [rad]."""
    return abs((a - b + np.pi) % (2 * np.pi) - np.pi)


@dataclass(frozen=True)
class Disc:
    """A disc in a window around a guess."""

    centre: FloatArray
    """Intensity-weighted centroid [px], shape (2,)."""
    strength: float
    """Chroma of its middle, in grey levels."""
    hue: float
    """Hue of the disc [rad]."""
    area: float
    """Area of the disc [px2]."""
    residual: float
    """RMS difference from a whole disc of the expected radius, relative to its strength."""
    matched_filter: FloatArray
    """Weight of a pixel per chroma, shape (2,): large for the disc, small for its surroundings."""

    @property
    def size(self) -> float:
        """Diameter [px]."""
        return 2 * float(np.sqrt(self.area / np.pi))


def measure_disc(
    image: Image, colour: ColourModel, guess: FloatArray, radius: float, target: FloatArray | None = None
) -> Disc | None:
    """The disc of this radius [px] near the guess (2,) [px]; None at the border of the picture.

    A matched filter weighs the pixels' chroma. `target` (2,) is the marker's own chroma; default: the chroma
    at the guess. It keeps its length as weight, and the filter is least for the surroundings of the disc
    (constrained energy minimisation, Harsanyi and Chang 1994). On a grey surface the weight is the chroma
    along the target. The opposite hue has no weight.
    """
    reach = ceil(radius + _BLUR_MARGIN) + 2
    x0, y0 = round(float(guess[0])) - reach, round(float(guess[1])) - reach
    x1, y1 = x0 + 2 * reach, y0 + 2 * reach
    if x0 < 0 or y0 < 0 or x1 >= image.shape[1] or y1 >= image.shape[0]:
        return None
    chroma = colour.to_chroma(image[y0 : y1 + 1, x0 : x1 + 1])
    side = np.arange(2 * reach + 1, dtype=np.float64)
    centre = np.array([guess[0] - x0, guess[1] - y0], np.float64)
    distance = _distances(side, centre)
    if target is None:
        target = _masked_mean(chroma, distance < 0.5 * radius)
    kernel = _matched_filter(target / max(hypot(*target), 1e-9), chroma[distance > radius + _BLUR_MARGIN])
    weight = np.maximum(chroma @ kernel.astype(np.float32), 0)
    for _ in range(3):
        strength = float(_masked_mean(weight, distance < 0.5 * radius))
        if not strength > 0:
            return None
        mass = np.maximum(weight - _WEIGHT_FLOOR * strength, 0)
        mass *= np.minimum(np.maximum(radius + _BLUR_MARGIN + 0.5 - distance, 0), 1)
        columns = mass.sum(axis=0)
        total = float(columns.sum())
        before, centre = centre, np.array([columns @ side, mass.sum(axis=1) @ side]) / total
        distance = _distances(side, centre)
        if np.abs(centre - before).max() < _CONVERGENCE:
            break
    middle = _masked_mean(chroma, distance < 0.5 * radius)
    whole = np.minimum(np.maximum((radius - distance) / _EDGE_WIDTH + 0.5, 0), 1)
    excess = (weight / strength - whole)[distance < radius + _BLUR_MARGIN]
    residual = sqrt(excess @ excess / len(excess))
    return Disc(
        centre + np.array([x0, y0]),
        strength,
        hue_angle(middle),
        total / strength / (1 - _WEIGHT_FLOOR),
        residual,
        kernel,
    )


def _matched_filter(direction: FloatArray, surroundings: FloatArray) -> FloatArray:
    """The filter (2,) with weight 1 for chroma of this `direction` (2,) and unit length, and the least energy
    in the chroma (N, 2) of the surroundings."""
    similar = surroundings[surroundings @ direction > 0]
    (a, b), (_, c) = (similar.T @ similar / max(len(surroundings), 1)).tolist()
    a, c = a + _CHROMA_NOISE**2, c + _CHROMA_NOISE**2
    x, y = direction.tolist()
    # The inverse of a 2 x 2 matrix up to a factor, which the next line divides out.
    unscaled = np.array([c * x - b * y, a * y - b * x])
    return unscaled / (unscaled @ direction)


def _masked_mean(values: FloatArray, mask: BoolArray) -> FloatArray:
    """Mean (...) of `values` (H, W, ...) where the mask (H, W) is set; 0 where it is empty. On few pixels
    numpy's own takes three times as long."""
    chosen = values[mask]
    return chosen.sum(axis=0) / max(len(chosen), 1)


def _distances(side: FloatArray, centre: FloatArray) -> FloatArray:
    return np.sqrt((side - centre[0]) ** 2 + ((side - centre[1]) ** 2)[:, None])
