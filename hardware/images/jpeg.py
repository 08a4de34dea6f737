"""Frames to JPEG and back.

Marks are found by their colour, so colour is kept at full resolution and better than brightness: at
the same size the centroid is twice as good as with a usual JPEG (docs/reference/log.md).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.plane import Image
from eldir.errors import InputError

_SETTINGS = [
    *(cv2.IMWRITE_JPEG_LUMA_QUALITY, 50),
    *(cv2.IMWRITE_JPEG_CHROMA_QUALITY, 88),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
]


def encode(image: Image) -> NDArray[np.uint8]:
    """JPEG bytes (N,) of a BGR frame."""
    return cv2.imencode(".jpg", image, _SETTINGS)[1].ravel()


def decode(data: NDArray[np.uint8]) -> Image:
    """BGR frame (H, W, 3) of compressed bytes."""
    try:
        image = cv2.imdecode(np.asarray(data, np.uint8), cv2.IMREAD_COLOR)
    except (cv2.error, MemoryError):  # a header that claims more pixels than OpenCV allocates
        image = None
    if image is None:
        raise InputError("a frame is damaged", expected="a JPEG or PNG picture", found=f"{len(data)} bytes")
    return image
