"""Writing video: VP9 in WebM, which browsers play and which needs no licence; and drawing a body into it."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from io import BytesIO
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eldir.core.files import write_bytes
from eldir.core.records import FloatArray, IntArray
from eldir.errors import InputError, MissingDependencyError

_CODEC = "libvpx-vp9"
_OPTIONS = {"crf": "20", "deadline": "realtime", "cpu-used": "8"}
"""Drawings and camera pictures keep their looks; slower settings take up to eighty times as long."""
_PREDICTION_COLOUR = (0, 159, 230)  # BGR of the report's colour for what is predicted, #E69F00
GROUND_COLOUR = (0, 255, 255)
"""BGR of the surface of a printed ground in pictures of a camera."""
_FRACTION_BITS = 3  # bits of a pixel's fraction


def encode_webm(frames: Iterable[np.ndarray], rate: float) -> bytes:
    """A film of RGB frames (height, width, 3) uint8 at `rate` a second."""
    import av

    remaining = iter(frames)
    first = next(remaining, None)
    if first is None:
        raise InputError("a video needs at least one frame")
    film = BytesIO()
    # Without this the file has a random number of its own, and no two are equal.
    with av.open(film, "w", format="webm", options={"fflags": "bitexact"}) as container:
        try:
            stream = container.add_stream(_CODEC, Fraction(rate).limit_denominator(1000), _OPTIONS)
        except ValueError:
            raise MissingDependencyError(
                f"this PyAV cannot write {_CODEC}", remedy="install the wheel of PyAV, which can"
            ) from None
        assert isinstance(stream, av.VideoStream)
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        for frame in chain([first], remaining):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode(None))
    return film.getvalue()


def write_webm(path: Path, frames: Iterable[np.ndarray], rate: float) -> None:
    """Write such a film; the whole file or none."""
    write_bytes(path, encode_webm(frames, rate))


def draw_body(picture: NDArray[np.uint8], pixels: FloatArray, springs: IntArray, text: str) -> None:
    """Draw into a BGR picture (H, W, 3) the masses at `pixels` (M, 2), the `springs` (S, 2) between them, and
    a line of text. A body that is not finite is left out."""
    import cv2

    if np.isfinite(pixels).all():
        points = np.round(pixels * 2**_FRACTION_BITS).astype(np.int32)
        for a, b in springs:
            cv2.line(
                picture,
                points[a].tolist(),
                points[b].tolist(),
                _PREDICTION_COLOUR,
                2,
                cv2.LINE_AA,
                _FRACTION_BITS,
            )
        for place in points:
            cv2.circle(
                picture,
                place.tolist(),
                7 << _FRACTION_BITS,
                _PREDICTION_COLOUR,
                2,
                cv2.LINE_AA,
                _FRACTION_BITS,
            )
    cv2.rectangle(picture, (0, 0), (10 * len(text) + 12, 28), (0, 0, 0), cv2.FILLED)
    cv2.putText(picture, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)


def draw_ground(picture: NDArray[np.uint8], pixels: FloatArray) -> None:
    """Draw into a BGR picture (H, W, 3) the surface of the ground with corners at `pixels` (K, 2)."""
    import cv2

    points = np.round(pixels * 2**_FRACTION_BITS).astype(np.int32)
    cv2.polylines(picture, [points], False, GROUND_COLOUR, 2, cv2.LINE_AA, _FRACTION_BITS)


def resize_to_width(picture: NDArray[np.uint8], width: int) -> tuple[NDArray[np.uint8], float]:
    """A copy of the picture that is `width` wide, with even sides as video needs them; and the scale."""
    import cv2

    scale = width / picture.shape[1]
    size = width, round(scale * picture.shape[0] / 2) * 2
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, size, interpolation=kind), np.uint8), scale
