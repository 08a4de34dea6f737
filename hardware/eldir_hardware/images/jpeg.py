"""Frames to JPEG and back; pictures of other formats are read too.

Markers are found by their colour, so colour is kept at full resolution and better than brightness: at the
same size the centroid is twice as good as with a usual JPEG (docs/reference/log.md).
"""

from __future__ import annotations

import os
import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from eldir.errors import damaged
from eldir_hardware.camera.plane import Image

_SETTINGS = [
    *(cv2.IMWRITE_JPEG_LUMA_QUALITY, 50),
    *(cv2.IMWRITE_JPEG_CHROMA_QUALITY, 88),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
]
_TIFF_ORIENTATION = 274


def silence_opencv() -> None:
    """Suppress OpenCV's own messages; call it before a file or a camera is opened."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def encode(image: Image) -> NDArray[np.uint8]:
    """JPEG bytes (N,) of a BGR frame."""
    return cv2.imencode(".jpg", image, _SETTINGS)[1].ravel()


def decode(data: NDArray[np.uint8]) -> Image:
    """BGR frame (H, W, 3) of compressed bytes, as the sensor took it: a lens belongs to the sensor, so a note
    on which way up to show the picture (EXIF orientation) does not count."""
    try:
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(_reset_tiff_orientation(np.asarray(data, np.uint8)), flags)
    except (cv2.error, MemoryError):  # a header that claims more pixels than OpenCV allocates
        image = None
    if image is None:
        raise damaged("a frame", "a JPEG or PNG picture", f"{len(data)} bytes")
    return image


def _reset_tiff_orientation(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The same bytes, of a TIFF with orientation 1: OpenCV applies that tag in spite of the flags."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4].tobytes())
    if order is None:
        return data
    whole = bytearray(data)
    try:
        (start,) = struct.unpack_from(f"{order}I", whole, 4)
        (count,) = struct.unpack_from(f"{order}H", whole, start)
        for entry in range(start + 2, start + 2 + 12 * count, 12):
            if struct.unpack_from(f"{order}H", whole, entry)[0] == _TIFF_ORIENTATION:
                struct.pack_into(f"{order}H", whole, entry + 8, 1)
    except struct.error:  # damaged: the decoder says so
        return data
    return np.frombuffer(whole, np.uint8)
