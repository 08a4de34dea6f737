"""Sources of frames: a camera, a video file, a folder of pictures, the log of a run."""

from __future__ import annotations

import csv
import logging
import math
import re
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np

from eldir.errors import InputError, damaged, missing, not_read
from eldir_hardware.camera.plane import Image
from eldir_hardware.images import jpeg
from eldir_hardware.images.file_kind import require_video
from eldir_hardware.images.jpeg import silence_opencv
from eldir_hardware.images.video import Video
from eldir_hardware.log.mcap_file import BAG_METADATA
from eldir_hardware.log.messages import VIRTUAL_EPOCH
from eldir_hardware.log.reader import RunLog, read_log
from eldir_hardware.rig.addresses import CAMERA_NAME, hide_password, is_camera

_logger = logging.getLogger(__name__)

TIMES_FILE = "times.csv"
"""File with the times of a folder of pictures: a line `file,t_s` for each."""
_URL = re.compile(r"[A-Za-z]{2,}:/|camera:")
_PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}
_MIN_DISTINCT_TIMES = (
    0.9  # different times per picture; two pictures of one time are a slip, many are no times
)
_PATTERN_INTERVAL = 0.5  # time between the frames of a film that are searched for a calibration pattern [s]
_MAX_CLOCK_DIFFERENCE = 1.0
"""If a driver's clock differs from ours by more than this, its timestamps are not used [s]."""
_STREAM_REMEDY = "check its address, and that the camera is on and in this network"
_REMEDY = "check its cable, and what there is: ls /dev/video*"


class Source(Protocol):
    """Frames that can be read repeatedly."""

    @property
    def name(self) -> str:
        """The path, for messages."""

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name: design, tags, plane."""

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        """Time [s] and BGR picture (H, W, 3) of each frame."""


def open_source(path: Path | str, rate: float | None = None, seconds: float = 10.0) -> Source:
    """Open the source at a path. `rate` [1/s]: of a folder or a film without times. `seconds`: to film with a
    camera.

    Raises `InputError` for a missing or unreadable source.
    """
    _logger.info("opening %s", path)
    if is_camera(str(path)):
        return CameraDevice(str(path), seconds)
    if not str(path) or _URL.match(str(path)):
        raise InputError(
            f"invalid address of a camera: {path}" if str(path) else "the name of the source is empty",
            code="camera.no-address",
            expected="a path, or camera:0, /dev/video0, http://..., https://... or rtsp://...",
        )
    path = Path(path)
    if not path.exists():
        raise missing(path)
    if path.is_dir() and (path / BAG_METADATA).exists():
        return LoggedFrames(read_log(path))
    if path.is_dir():
        return PictureFolder(path, rate)
    if path.suffix == ".mcap":
        return LoggedFrames(read_log(path))
    if path.suffix.lower() in _PICTURES:
        return PictureFolder(path, rate)
    require_video(path)
    return Video(path, rate)


def log_time(epoch_ns: int) -> datetime:
    """Time at which a log that begins at `epoch_ns` [ns] was recorded; now for one with virtual times."""
    return datetime.fromtimestamp(epoch_ns * 1e-9, UTC) if epoch_ns > VIRTUAL_EPOCH else datetime.now(UTC)


def recording_time(source: Source) -> datetime:
    """Time at which a source was recorded: from its log, from the file's date, or now for a camera."""
    if isinstance(source, LoggedFrames):
        return log_time(source.log.epoch_ns)
    if isinstance(source, Video | PictureFolder):
        return datetime.fromtimestamp(source.path.stat().st_mtime, UTC)
    return datetime.now(UTC)


@dataclass(frozen=True)
class PictureFolder:
    """Pictures in a folder, in the order of the numbers in their names, or of their times; or one picture."""

    path: Path
    rate: float | None
    attachments: dict[str, bytes] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The path, for messages."""
        return str(self.path)

    @property
    def has_times(self) -> bool:
        """Whether a table gives the times."""
        return (self.path / TIMES_FILE).exists()

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        return ((t, _read_picture(file)) for t, file in self._files())

    def pictures(self) -> Iterator[tuple[Path, Image]]:
        """File and picture, where times do not matter."""
        return ((file, _read_picture(file)) for _, file in self._files())

    def _files(self) -> list[tuple[float, Path]]:
        if self.path.is_file():
            return [(0.0, self.path)]
        if self.has_times:
            return _read_times(self.path / TIMES_FILE)
        files = sorted((f for f in self.path.iterdir() if f.suffix.lower() in _PICTURES), key=_natural_order)
        if not files:
            raise InputError(
                f"{self.path} holds no pictures",
                code="film.no-pictures",
                expected=", ".join(sorted(_PICTURES)),
                found=f"{count} other files"
                if (count := len(list(self.path.iterdir())))
                else "an empty folder",
            )
        if self.rate is None:
            raise InputError(
                f"the pictures in {self.path} have no timestamps",
                code="film.no-timestamps",
                remedy=f"give their rate, such as --rate 10, or their times in {TIMES_FILE}",
            )
        return [(number / self.rate, file) for number, file in enumerate(files)]


def _read_times(table: Path) -> list[tuple[float, Path]]:
    """Time [s] and file of each picture that a table names, in the order of time."""
    rows = _read_table(table)
    try:
        files = [(float(row["t_s"].replace(",", ".")), table.parent / row["file"]) for row in rows]
    except (KeyError, ValueError) as error:
        raise damaged(table, "columns file and t_s [s]", f"{type(error).__name__}: {error}") from None
    wrong = next((f"{file.name} at {t} s" for t, file in files if not math.isfinite(t)), None)
    if wrong or not files:
        raise damaged(table, "a time for each picture", wrong or "no picture")
    lost = next((file for _, file in files if not file.exists()), None)
    if lost is not None:
        raise missing(lost, f"{TIMES_FILE} names it")
    distinct = len({t for t, _ in files})
    if distinct < _MIN_DISTINCT_TIMES * len(files):
        raise InputError(
            f"{table} has wrong times",
            code="film.wrong-timestamps",
            expected="a time of its own for each picture",
            found=f"{distinct} different times of {len(files)} pictures",
            remedy="correct them, or remove the table and give --rate",
        )
    return sorted(files, key=lambda timed: timed[0])


def _read_table(table: Path) -> list[dict[str, str]]:
    """The rows of a table as a spreadsheet may write it: with a byte order marker, separated by commas,
    semicolons or tabs, with spaces around the values, and decimal commas between semicolons."""
    try:
        text = table.read_text("utf-8-sig")
    except OSError as error:
        raise not_read(table, error) from None
    except UnicodeDecodeError:
        raise damaged(table, "a table (CSV) in UTF-8", "binary data") from None
    lines = [line for line in text.splitlines() if line.strip()] or [""]
    separator = next((c for c in ",;\t " if c in lines[0]), ",")
    cells = [
        [c.strip() for c in row] for row in csv.reader(lines, delimiter=separator, skipinitialspace=True)
    ]
    return [dict(zip(cells[0], row, strict=False)) for row in cells[1:]]


@dataclass(frozen=True)
class LoggedFrames:
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
            raise InputError(
                f"{self.name} holds no frames", code="log.no-frames", remedy="record the run with a camera"
            )
        return self.log.frames


def _read_picture(file: Path) -> Image:
    silence_opencv()
    try:
        return jpeg.decode(np.fromfile(file, np.uint8))
    except InputError:
        raise InputError(
            f"{file} cannot be decoded",
            code="film.not-decoded",
            expected="a picture of a usual size",
            remedy="remove it, or make it smaller",
        ) from None
    except OSError as error:
        raise not_read(file, error) from None


def _natural_order(file: Path) -> list[tuple[int, int, str]]:
    """Sort key: frame9 comes before frame10."""
    return [(0, int(p), "") if p.isdigit() else (1, 0, p) for p in re.split(r"(\d+)", file.name) if p]


def calibration_pictures(frames: Source) -> Iterator[tuple[str, Image]]:
    """Pictures that are searched for a calibration pattern: name and picture of every photograph in a
    folder, or of two frames a second of a film."""
    if isinstance(frames, PictureFolder):
        for file, image in frames.pictures():
            yield file.name, image
        return
    due = 0.0
    for t, image in frames:
        if t >= due:
            due = t + _PATTERN_INTERVAL
            yield f"the frame at {t:.1f} s", image


class TimedPicture(NamedTuple):
    """A picture and the time at which to show it."""

    due: float
    """Seconds since the first picture."""
    stamp_ns: int | None
    """The recorded stamp [ns]; None where the source has none, and the moment of showing counts."""
    data: bytes
    """JPEG."""


def timed_pictures(source: str, rate: float) -> Iterator[TimedPicture]:
    """The pictures of a camera, a video, a folder or a log, to play them at their pace; those of a log keep
    their bytes and stamps.

    `rate` [1/s] is for a folder without times. Raises `InputError` where the source cannot be read.
    """
    opened = open_source(source, rate, seconds=float("inf"))
    first: float | None = None
    if isinstance(opened, LoggedFrames):
        for stamp, data in opened.log.pictures:
            first = 1e-9 * stamp if first is None else first
            yield TimedPicture(1e-9 * stamp - first, stamp, data.tobytes())
        return
    for t, image in opened:
        first = t if first is None else first
        yield TimedPicture(t - first, None, jpeg.encode(image).tobytes())


@dataclass(frozen=True)
class CameraDevice:
    """A camera of this computer or a network stream; each iteration films for `seconds` again."""

    name: str
    """Name of the camera, such as camera:0, /dev/video0 or http://phone:8080/video."""
    seconds: float
    attachments: dict[str, bytes] = field(default_factory=dict)
    open: Callable[[Any], Any] = cv2.VideoCapture
    """Opens a device by number, or by path or address."""
    size: tuple[int, int] | None = None
    """Width and height to request from a device [px]; a stream sets its own."""
    rate: float | None = None
    """Frame rate to request from a device [1/s]."""

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        """Time since the first frame [s] (time of exposure if the driver reports it), and picture."""
        first = None
        with closing(self.frames()) as frames:
            for t, image in frames:
                first = t if first is None else first
                if t - first > self.seconds:
                    return
                yield t - first, image

    def frames(self) -> Generator[tuple[float, Image]]:
        """Endless frames: time on the monotonic clock [s] (of exposure if the driver reports it, else of
        arrival), and picture. Raises `InputError` if the camera gives no picture."""
        match = CAMERA_NAME.fullmatch(self.name)
        assert match is not None
        number, path, stream = match["number"], match["path"], match["stream"]
        silence_opencv()
        capture = self.open(int(number) if number else path or stream)
        try:
            self._configure(capture)
            pictures = 0
            while True:
                good, image = capture.read()
                now = time.monotonic()
                if not good:
                    raise InputError(
                        f"{hide_password(self.name)} gives no picture" + (" any more" if pictures else ""),
                        code="camera.no-picture",
                        expected="a video stream" if stream else "a camera that nothing else uses",
                        remedy=_STREAM_REMEDY if stream else _REMEDY,
                    )
                stamp = capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3  # V4L2 stamps on the monotonic clock
                yield stamp if not stream and abs(now - stamp) < _MAX_CLOCK_DIFFERENCE else now, image
                pictures += 1
        finally:
            capture.release()

    def _configure(self, capture: Any) -> None:
        if self.size is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self.size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self.size[1])
        if self.rate is not None:
            capture.set(cv2.CAP_PROP_FPS, self.rate)
