"""Small films in many files: each picture shows its own number, and each file has known times."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

RATE = 10
SIZE = (64, 48)
DARK, BRIGHT = 40, 200
BARS = 8


def numbered(number: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A picture with the bits of a number as bright bars, from left to right."""
    image = np.full((size[1], size[0], 3), DARK, np.uint8)
    for bit, part in enumerate(np.array_split(np.arange(size[0]), BARS)):
        if number >> bit & 1:
            image[:, part] = BRIGHT
    return image


def number_in(image: np.ndarray) -> int:
    """The number that a picture shows."""
    grey = image.mean(axis=(0, 2))
    middles = [part[len(part) // 2] for part in np.array_split(np.arange(image.shape[1]), BARS)]
    return sum(1 << bit for bit, x in enumerate(middles) if grey[x] > (DARK + BRIGHT) / 2)


def write_film(
    path: Path,
    codec: str = "libx264",
    stamps: Sequence[int] = range(30),
    *,
    numbers: Sequence[int] | None = None,
    pixels: str = "yuv420p",
    size: tuple[int, int] = SIZE,
    options: dict[str, str] | None = None,
    container: dict[str, str] | None = None,
    kind: str | None = None,
    rotation: int = 0,
    pixel_aspect: Fraction | None = None,
    noise: float = 0.0,
) -> Path:
    """Encode one picture for each stamp [1/RATE s]; numbers are 0, 1, 2, ... unless given.
    `noise` [grey levels] makes packets that are large enough to damage."""
    random = np.random.default_rng(0)
    with av.open(str(path), "w", format=kind, options=container or {}) as file:
        stream = file.add_stream(codec, rate=RATE)
        stream.width, stream.height, stream.pix_fmt = *size, pixels
        stream.options = options or {}
        if pixel_aspect is not None:
            stream.codec_context.sample_aspect_ratio = pixel_aspect
        if rotation:
            stream.set_display_rotation(rotation)
        for number, stamp in zip(numbers or range(len(stamps)), stamps, strict=True):
            image = numbered(number, size)
            image = np.clip(image + random.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format=pixels)
            frame.pts, frame.time_base = stamp, Fraction(1, RATE)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path


def damage(path: Path, number: int, begin: float, end: float) -> None:
    """Invert bits between two parts of a packet; packets are counted from 0."""
    with av.open(str(path)) as file:
        packet = [p for p in file.demux(video=0) if p.size][number]
    data = bytearray(path.read_bytes())
    assert packet.pos is not None
    for k in range(packet.pos + int(begin * packet.size), packet.pos + int(end * packet.size)):
        data[k] ^= 0x5A
    path.write_bytes(data)
