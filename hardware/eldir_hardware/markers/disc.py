"""Measures one coloured disc to a small part of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot, sqrt

import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir_hardware.camera.plane import Image
from eldir_hardware.markers.colour import ColourModel, hue

_MARGIN = 2.5
"""Width of the blurred margin around the disc that still counts [px]."""
_FLOOR = 0.1
"""Part of the disc's strength that is subtracted from every weight: noise and tinted background."""
_GRAIN = 8.0
"""Chroma of noise and of a grey surface's tints, root mean square in grey levels. Where what surrounds the
disc has more, it counts as coloured."""
_SOFT = 2.4
"""Width over which a blurred edge falls from disc to background [px]."""
_STILL = 0.05
"""A centre that moves less is found: the next step is a tenth as long or shorter [px]."""


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
    toward: FloatArray
    """What the chroma of a pixel is multiplied by to give its weight, shape (2,)."""

    @property
    def size(self) -> float:
        """Diameter [px]."""
        return 2 * float(np.sqrt(self.area / np.pi))


def measure_disc(
    image: Image, colour: ColourModel, guess: FloatArray, radius: float, toward: FloatArray | None = None
) -> Disc | None:
    """The disc of this radius [px] near the guess [px]; None at the border of the picture.

    Weights are linear in the pixels' chroma: `toward` (2,), the mark's own chroma, or where it is not known
    yet, the chroma found at the guess, has its length as weight, and of all such weights they are the one
    that is least for what surrounds the disc (constrained energy minimisation, Harsanyi and Chang 1994). On
    a grey surface that is the chroma along `toward`. The opposite hue has no weight.
    """
    reach = ceil(radius + _MARGIN) + 2
    x0, y0 = round(float(guess[0])) - reach, round(float(guess[1])) - reach
    x1, y1 = x0 + 2 * reach, y0 + 2 * reach
    if x0 < 0 or y0 < 0 or x1 >= image.shape[1] or y1 >= image.shape[0]:
        return None
    chroma = colour.chroma(image[y0 : y1 + 1, x0 : x1 + 1])
    side = np.arange(2 * reach + 1, dtype=np.float64)
    centre = np.array([guess[0] - x0, guess[1] - y0], np.float64)
    distance = _distance(side, centre)
    if toward is None:
        toward = _mean(chroma, distance < 0.5 * radius)
    toward = _against(toward / max(hypot(*toward), 1e-9), chroma[distance > radius + _MARGIN])
    weight = np.maximum(chroma @ toward.astype(np.float32), 0)
    for _ in range(3):
        strength = float(_mean(weight, distance < 0.5 * radius))
        if not strength > 0:
            return None
        mass = np.maximum(weight - _FLOOR * strength, 0)
        mass *= np.minimum(np.maximum(radius + _MARGIN + 0.5 - distance, 0), 1)
        columns = mass.sum(axis=0)
        total = float(columns.sum())
        before, centre = centre, np.array([columns @ side, mass.sum(axis=1) @ side]) / total
        distance = _distance(side, centre)
        if np.abs(centre - before).max() < _STILL:
            break
    middle = _mean(chroma, distance < 0.5 * radius)
    whole = np.minimum(np.maximum((radius - distance) / _SOFT + 0.5, 0), 1)
    excess = (weight / strength - whole)[distance < radius + _MARGIN]
    residual = sqrt(excess @ excess / len(excess))
    return Disc(
        centre + np.array([x0, y0]), strength, hue(middle), total / strength / (1 - _FLOOR), residual, toward
    )


def _against(toward: FloatArray, around: FloatArray) -> FloatArray:
    """The direction `toward` (2,) of unit length, turned away from the chroma (N, 2) around a disc."""
    alike = around[around @ toward > 0]
    (a, b), (_, c) = (alike.T @ alike / max(len(around), 1)).tolist()
    a, c = a + _GRAIN**2, c + _GRAIN**2
    x, y = toward.tolist()
    # The inverse of a 2 x 2 matrix up to a factor, which the next line divides out.
    turned = np.array([c * x - b * y, a * y - b * x])
    return turned / (turned @ toward)


def _mean(values: FloatArray, mask: BoolArray) -> FloatArray:
    """Mean (...) of `values` (H, W, ...) where the mask (H, W) is set; 0 where it is empty. On few pixels
    numpy's own takes three times as long."""
    chosen = values[mask]
    return chosen.sum(axis=0) / max(len(chosen), 1)


def _distance(side: FloatArray, centre: FloatArray) -> FloatArray:
    return np.sqrt((side - centre[0]) ** 2 + ((side - centre[1]) ** 2)[:, None])
