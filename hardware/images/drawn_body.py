"""A body drawn over a picture: its springs as lines, its masses as rings."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from eldir.core.records import FloatArray, IntArray

_COLOUR = (0, 159, 230)  # BGR of the report's colour for what is predicted, #E69F00
_EIGHTHS = 3  # bits of a pixel's fraction
_LINE = cv2.LINE_AA


def draw_body(picture: NDArray[np.uint8], pixels: FloatArray, springs: IntArray, text: str) -> None:
    """Draw into a BGR picture (H, W, 3) the masses at `pixels` (M, 2), the `springs` (S, 2) between them, and
    a line of text. A body that is not finite is left out."""
    if np.isfinite(pixels).all():
        at = np.round(pixels * 2**_EIGHTHS).astype(np.int32)
        for a, b in springs:
            cv2.line(picture, at[a].tolist(), at[b].tolist(), _COLOUR, 2, _LINE, _EIGHTHS)
        for place in at:
            cv2.circle(picture, place.tolist(), 7 << _EIGHTHS, _COLOUR, 2, _LINE, _EIGHTHS)
    cv2.rectangle(picture, (0, 0), (10 * len(text) + 12, 28), (0, 0, 0), cv2.FILLED)
    cv2.putText(picture, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, _LINE)


def scaled(picture: NDArray[np.uint8], width: int) -> tuple[NDArray[np.uint8], float]:
    """A copy of the picture that is `width` wide, with even sides as video needs them; and the scale."""
    scale = width / picture.shape[1]
    size = width, round(scale * picture.shape[0] / 2) * 2
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, size, interpolation=kind), np.uint8), scale
