"""Where frames come from: a video file, a folder of pictures, the log of a run."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import cv2

from calibration.plane import Image
from eldir.errors import InputError
from hardware.log.reader import RunLog, read_log

_PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}


class Source(Protocol):
    """Frames that can be gone through again and again."""

    @property
    def name(self) -> str:
        """The path, for messages."""

    @property
    def attachments(self) -> dict[str, bytes]:
        """Files that came with the frames, by name: design, tags, plane."""

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        """Time [s] and BGR picture (H, W, 3) of each frame."""


def open_source(path: Path | str, rate: float | None = None) -> Source:
    """What the path holds. `rate` [1/s] is for a folder, whose pictures carry no times."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path} does not exist", remedy="check the path")
    if path.is_dir():
        return Folder(path, rate)
    if path.suffix == ".mcap":
        return Log(read_log(path))
    return Video(path)


@dataclass(frozen=True)
class Video:
    """A video file, with the times it carries."""

    path: Path
    attachments: dict[str, bytes] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The path, for messages."""
        return str(self.path)

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        # What is wrong with a file is told in our own one line.
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        try:
            good, image = capture.read()
            if not good:
                raise InputError(
                    f"{self.path} cannot be decoded",
                    expected="a video, a folder of pictures or an .mcap log",
                    remedy="convert it, for instance with ffmpeg to .mp4",
                )
            while good:
                yield capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3, image
                good, image = capture.read()
        finally:
            capture.release()


@dataclass(frozen=True)
class Folder:
    """Pictures in a folder, in the order of the numbers in their names."""

    path: Path
    rate: float | None
    attachments: dict[str, bytes] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The path, for messages."""
        return str(self.path)

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        files = sorted((f for f in self.path.iterdir() if f.suffix.lower() in _PICTURES), key=_natural)
        if not files:
            raise InputError(
                f"{self.path} holds no pictures",
                expected=", ".join(sorted(_PICTURES)),
                found=f"{len(list(self.path.iterdir()))} other files",
            )
        if self.rate is None:
            raise InputError(
                f"the pictures in {self.path} carry no times", remedy="give their rate, such as --rate 10"
            )
        for number, file in enumerate(files):
            image = cv2.imread(str(file), cv2.IMREAD_COLOR)
            if image is None:
                raise InputError(f"{file} cannot be decoded", expected="a picture", remedy="remove it")
            yield number / self.rate, image


@dataclass(frozen=True)
class Log:
    """The frames of a run's log."""

    log: RunLog

    @property
    def name(self) -> str:
        """The path, for messages."""
        return str(self.log.path)

    @property
    def attachments(self) -> dict[str, bytes]:
        """Files kept with the log."""
        return self.log.attachments

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        if not self.log.frame_count:
            raise InputError(f"{self.name} holds no frames", remedy="record the run with a camera")
        return self.log.frames


def _natural(file: Path) -> list[tuple[int, int, str]]:
    """Sorts frame9 before frame10."""
    return [(0, int(p), "") if p.isdigit() else (1, 0, p) for p in re.split(r"(\d+)", file.name) if p]
