"""Measures one coloured disc to a small part of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.camera.plane import Image
from eldir.core.records import FloatArray
from hardware.markers.colour import ColourModel, hue

_MARGIN = 2.5
"""Width of the blurred margin around the disc that still counts [px]."""
_FLOOR = 0.1
"""Part of the disc's strength that is subtracted from every weight: noise and tinted background."""
_GRAIN = 8.0
"""Chroma of noise and of a grey surface's tints, root mean square in grey levels. Where what surrounds the
disc has more, it counts as coloured."""
_SOFT = 2.4
"""Width over which a blurred edge falls from disc to background [px]."""


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
    reach = int(np.ceil(radius + _MARGIN)) + 2
    x, y = np.round(guess).astype(int)
    x0, y0 = x - reach, y - reach
    if x0 < 0 or y0 < 0 or x + reach >= image.shape[1] or y + reach >= image.shape[0]:
        return None
    chroma = colour.chroma(image[y0 : y + reach + 1, x0 : x + reach + 1])
    side = np.arange(2 * reach + 1, dtype=np.float64)
    centre = np.asarray(guess, np.float64) - (x0, y0)
    if toward is None:
        toward = chroma[_distance(side, centre) < 0.5 * radius].mean(axis=0)
    around = chroma[_distance(side, centre) > radius + _MARGIN]
    toward = _against(toward / max(float(np.hypot(*toward)), 1e-9), around)
    weight = np.maximum(chroma @ toward.astype(np.float32), 0)
    strength = 0.0
    for _ in range(3):
        distance = _distance(side, centre)
        strength = float(weight[distance < 0.5 * radius].mean())
        if not strength > 0:
            return None
        mass = np.maximum(weight - _FLOOR * strength, 0) * np.clip(radius + _MARGIN + 0.5 - distance, 0, 1)
        total = mass.sum()
        centre = np.array([mass.sum(axis=0) @ side, mass.sum(axis=1) @ side]) / total
    distance = _distance(side, centre)
    middle = chroma[distance < 0.5 * radius].mean(axis=0)
    window = distance < radius + _MARGIN
    whole = np.clip((radius - distance) / _SOFT + 0.5, 0, 1)
    residual = float(np.sqrt(((weight / strength - whole)[window] ** 2).mean()))
    return Disc(
        centre + np.array([x0, y0]),
        strength,
        hue(middle),
        float(total / strength / (1 - _FLOOR)),
        residual,
        toward,
    )


def _against(toward: FloatArray, around: FloatArray) -> FloatArray:
    """The direction `toward` (2,) of unit length, turned away from the chroma (N, 2) around a disc."""
    alike = around[around @ toward > 0]
    power = alike.T @ alike / max(len(around), 1) + _GRAIN**2 * np.eye(2)
    # The inverse of a 2 x 2 matrix up to a factor, which the next line divides out.
    turned = np.array(
        [
            power[1, 1] * toward[0] - power[0, 1] * toward[1],
            power[0, 0] * toward[1] - power[0, 1] * toward[0],
        ]
    )
    return turned / (turned @ toward)


def _distance(side: FloatArray, centre: FloatArray) -> FloatArray:
    return np.sqrt((side - centre[0]) ** 2 + ((side - centre[1]) ** 2)[:, None])
