"""Liang and Rogers' kinetics of the transformation between martensite and austenite.

Written for a change from T to T' they need no memory of the point where the temperature reversed, and minor
loops start from the fraction at that point:

    heating   xi' = xi gA(T')/gA(T)                      gA = [cos(pi (T - As)/(Af - As)) + 1]/2
    cooling   1 - xi' = (1 - xi) (1 - gM(T'))/(1 - gM(T))   gM = [cos(pi (T - Mf)/(Ms - Mf)) + 1]/2
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir.parameters.springs import SpringParameters


class Kinetics:
    """The two cosines of the kinetics of A springs, evaluated together."""

    def __init__(self, parameters: Sequence[SpringParameters]):
        self.low = np.array(
            [[p.austenite_start for p in parameters], [p.martensite_finish for p in parameters]]
        )
        self.high = np.array(
            [[p.austenite_finish for p in parameters], [p.martensite_start for p in parameters]]
        )
        self.scale = np.pi / (self.high - self.low)

    def cosines(self, temperature: FloatArray) -> FloatArray:
        """gA, the martensite left by heating, and 1 - gM, the austenite left by cooling, shape (2, A)."""
        angle = np.minimum(np.maximum((temperature - self.low) * self.scale, 0.0), np.pi)
        cosine = np.cos(angle)
        cosine[1] *= -1.0
        return (cosine + 1.0) / 2.0

    def austenite_left(self, temperature: FloatArray) -> FloatArray:
        """The second of these cosines, at temperatures of shape (..., A)."""
        angle = (temperature - self.low[1]) * self.scale[1]
        return (1.0 - np.cos(np.minimum(np.maximum(angle, 0.0), np.pi))) / 2.0

    @staticmethod
    def fraction(xi: FloatArray, before: FloatArray, heating: BoolArray, after: FloatArray) -> FloatArray:
        """The martensite after a monotone change of the cosines from `before` to `after`."""
        ratio = np.divide(after, before, out=np.zeros_like(before), where=before > 0)
        np.minimum(ratio, 1.0, out=ratio)
        return np.where(heating, xi * ratio[0], 1.0 - (1.0 - xi) * ratio[1])
