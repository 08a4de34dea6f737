"""The printed marks that a user glues onto masses m1 to m5: nominal colours and size.

Both the tracker and the virtual camera know the sheet, as a person does. How light, printer and
camera change its colours, the tracker learns from the picture.
"""

from __future__ import annotations

import numpy as np

MARK_DIAMETER = 0.0105
"""Diameter of every disc [m]."""

PALETTE = {
    "m1": (214, 40, 40),
    "m2": (235, 200, 20),
    "m3": (30, 160, 60),
    "m4": (30, 90, 210),
    "m5": (190, 40, 190),
}
"""sRGB of the disc on each mass: hues far apart, so that each mark is recognised by its own."""


def nominal_bgr(name: str) -> np.ndarray:
    """Colour of a mark as OpenCV orders it, 0 to 255, shape (3,)."""
    return np.array(PALETTE[name][::-1], dtype=np.float64)
