"""Pictures in which a calibration pattern is looked for."""

from __future__ import annotations

from collections.abc import Iterator

from calibration.camera.plane import Image
from hardware.vision.sources import Folder, Source

_EVERY = 0.5  # time between the frames of a film that are used [s]


def named_pictures(frames: Source) -> Iterator[tuple[str, Image]]:
    """Name and picture of every photograph in a folder, or of two frames a second of a film."""
    if isinstance(frames, Folder):
        for file, image in frames.pictures():
            yield file.name, image
        return
    due = 0.0
    for t, image in frames:
        if t >= due:
            due = t + _EVERY
            yield f"the frame at {t:.1f} s", image
