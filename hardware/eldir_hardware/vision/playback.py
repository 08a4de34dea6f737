"""The pictures of any source as JPEG, with the time at which each is due: to show a source at its pace."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from eldir_hardware.camera.lens import Lens
from eldir_hardware.images import jpeg
from eldir_hardware.rig.camera_name import is_camera
from eldir_hardware.vision.recording_setup import attached_lens
from eldir_hardware.vision.sources import LoggedFrames, open_source


class DuePicture(NamedTuple):
    """One picture and when to show it."""

    due: float
    """Seconds since the first picture."""
    stamp_ns: int | None
    """The recorded stamp [ns]; None where the source has none, and the moment of showing counts."""
    data: bytes
    """JPEG."""


def timed_pictures(source: str, rate: float) -> Iterator[DuePicture]:
    """The pictures of a camera, a video, a folder or a log; those of a log keep their bytes and stamps.

    `rate` [1/s] is for a folder without times. Raises `InputError` where the source cannot be read.
    """
    opened = open_source(source, rate, seconds=float("inf"))
    first: float | None = None
    if isinstance(opened, LoggedFrames):
        for stamp, data in opened.log.pictures:
            first = 1e-9 * stamp if first is None else first
            yield DuePicture(1e-9 * stamp - first, stamp, data.tobytes())
        return
    for t, image in opened:
        first = t if first is None else first
        yield DuePicture(t - first, None, jpeg.encode(image).tobytes())


def lens_of(source: str) -> Lens | None:
    """The lens that a log keeps; None for every other source."""
    if is_camera(source):
        return None
    opened = open_source(source)
    return attached_lens(opened) if isinstance(opened, LoggedFrames) else None
