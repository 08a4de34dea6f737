"""Writing video: VP9 or VP8 in WebM, which browsers play and which need no licence."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from eldir.errors import EldirError, InputError, not_written

Codec = Literal["VP90", "VP80"]
_EBML, _SEGMENT = bytes.fromhex("1A45DFA3"), bytes.fromhex("18538067")  # the two parts of a WebM file
_HEAD = 256  # bytes that hold the first part and the length of the second


def write_webm(path: Path, frames: Iterable[np.ndarray], rate: float, code: Codec = "VP90") -> int:
    """Write RGB frames (height, width, 3) uint8 at `rate` a second; the whole file or none. VP80 takes a
    fifth of the time of VP90. Returns the number of frames."""
    ahead = iter(frames)
    first = next(ahead, None)
    if first is None:
        raise InputError("a video needs at least one frame")
    height, width = first.shape[:2]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".video.", suffix=".webm", dir=path.parent)
    except OSError as error:
        raise not_written(path, error) from None
    os.close(handle)
    draft = Path(name)
    try:
        count = _encode(draft, chain([first], ahead), rate, (width, height), code)
        if not _is_whole(draft):
            why = "not all of the video could be stored"
            raise not_written(path, why, "choose another place or make room there")
        draft.chmod(0o644)
        draft.replace(path)
    except OSError as error:
        raise not_written(path, error) from None
    finally:
        draft.unlink(missing_ok=True)
    return count


def _encode(path: Path, frames: Iterable[np.ndarray], rate: float, size: tuple[int, int], code: Codec) -> int:
    with _quiet(), _in_utf8(path) as name:
        writer = cv2.VideoWriter(name, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*code), rate, size)
    if not writer.isOpened():
        raise EldirError(
            f"this OpenCV cannot write {code}",
            expected="a build with FFmpeg, as in the opencv-python-headless wheels",
        )
    count = 0
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # it warns for each frame not stored
    try:
        for frame in frames:
            writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
            count += 1
    finally:
        writer.release()
        cv2.utils.logging.setLogLevel(level)
    return count


@contextmanager
def _in_utf8(path: Path) -> Iterator[str]:
    """A name by which OpenCV can open a file: one in a folder whose name is not UTF-8 ends the program."""
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        plain = str(path).isprintable()  # undecodable bytes are not
        yield str(path) if plain else f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


def _is_whole(path: Path) -> bool:
    """Whether all of a WebM file is stored. FFmpeg notes the length of what follows at the end, and writes
    nothing more once it could not write something; OpenCV tells no one. Raises `OSError` if the disk does."""
    with path.open("rb") as file:
        os.fsync(file.fileno())
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        head = file.read(_HEAD)
    try:
        length, begin = _element(head, 0, _EBML)
        length, begin = _element(head, begin + length, _SEGMENT)
    except (IndexError, ValueError):
        return False
    return begin + length == size


def _element(data: bytes, at: int, kind: bytes) -> tuple[int, int]:
    """Length of the contents of an EBML element of that kind, and where they begin."""
    if not data.startswith(kind, at):
        raise ValueError
    at += len(kind)
    width = 9 - data[at].bit_length()
    return int.from_bytes(data[at : at + width]) & ((1 << 7 * width) - 1), at + width


@contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV prints straight to stderr that WebM has no tag "VP90", then writes it all the same."""
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
