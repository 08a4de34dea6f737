"""What numbered squares look like in print: those on the masses, and the reference tags."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir_hardware.camera.plane import Image

_PAPER, _INK = 0.85, 0.05
"""Linear reflectance of paper and ink."""


@lru_cache
def square_cells(dictionary: str, number: int) -> Image:
    """The cells of a square with its black border (N, N), 0 and 255, in OpenCV's dictionary of that name."""
    tags = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    return cv2.aruco.generateImageMarker(tags, number, tags.markerSize + 2)


def paint_square(
    cells: Image, side: float, border: float, points: FloatArray, width: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A square of this side on white paper that is wider by `border` on each side [m].

    At points (..., 2) from its centre [m], each as wide as `width` (...) [m]: the part that the paper covers
    (...), and its linear reflectance (..., 1). Soft edges keep their places exact.
    """
    x, y = points[..., 0], -points[..., 1]
    half = side / 2 + border
    cover = _share(x, -half, half, width) * _share(y, -half, half, width)
    column, right = _line(x, side, len(cells), width)
    row, below = _line(y, side, len(cells), width)
    black = np.pad(np.where(cells == 0, 1.0, 0.0), 1).ravel()
    at, beyond = row * (len(cells) + 2) + column, len(cells) + 2
    above = black[at] + right * (black[at + 1] - black[at])
    under = black[at + beyond] + right * (black[at + beyond + 1] - black[at + beyond])
    return cover, (_PAPER + (above + below * (under - above)) * (_INK - _PAPER))[..., None]


def _share(x: FloatArray, low: float, high: float, width: float | FloatArray) -> FloatArray:
    """Part of a point at x that lies between two lines."""
    return np.clip((x - low) / width + 0.5, 0, 1) - np.clip((x - high) / width + 0.5, 0, 1)


def _line(x: FloatArray, side: float, cells: int, width: float | FloatArray) -> tuple[IntArray, FloatArray]:
    """The line between cells that is nearest to x, 0 at the square's edge, and the part of a point at x that
    lies behind it. A point is narrower than a cell."""
    cell = side / cells
    line = np.clip(np.rint(x / cell + cells / 2), 0, cells)
    behind = np.clip((x - (line - cells / 2) * cell) / np.minimum(width, cell) + 0.5, 0, 1)
    return line.astype(np.intp), behind
