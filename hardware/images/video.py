"""Writing video: VP9 in WebM, which browsers play and which needs no licence."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from io import BytesIO
from itertools import chain
from pathlib import Path

import numpy as np

from eldir.core.files import write_bytes
from eldir.errors import InputError, MissingDependencyError

_CODEC = "libvpx-vp9"
_OPTIONS = {"crf": "20", "deadline": "realtime", "cpu-used": "8"}
"""Drawings and camera pictures keep their looks; slower settings take up to eighty times as long."""


def encode_webm(frames: Iterable[np.ndarray], rate: float) -> bytes:
    """A film of RGB frames (height, width, 3) uint8 at `rate` a second."""
    import av

    ahead = iter(frames)
    first = next(ahead, None)
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
        for frame in chain([first], ahead):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode(None))
    return film.getvalue()


def write_webm(path: Path, frames: Iterable[np.ndarray], rate: float) -> None:
    """Write such a film; the whole file or none."""
    write_bytes(path, encode_webm(frames, rate))
