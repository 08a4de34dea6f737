"""Recognises a file by its first bytes, to refuse in one sentence what is neither a film nor a log."""

from __future__ import annotations

import stat
from pathlib import Path

from eldir.errors import InputError, empty, not_read

_EXPECTED = "a video, a folder of pictures or an .mcap log"
_HEAD_BYTES = 4096  # bytes that tell what a file is
_BAG_REMEDY = (
    "name the log that the run itself wrote (.mcap); for `eldir track`, export the pictures to a folder with "
    "times.csv"
)
_OTHER_KINDS = (  # first bytes, what the file is, what to do
    (b"#ROSBAG V", "is a bag of ROS 1", _BAG_REMEDY),
    (b"SQLite format 3\0", "is an SQLite database, such as a bag of ROS 2 (.db3)", _BAG_REMEDY),
    (b"\x28\xb5\x2f\xfd", "is compressed with zstd as a whole", "decompress it: zstd -d {name}"),
    (b"\x04\x22\x4d\x18", "is compressed with lz4 as a whole", "decompress it: lz4 -d {name}"),
    (b"\x1f\x8b", "is compressed with gzip", "decompress it: gzip -d {name}"),
    (b"PK\x03\x04", "is a ZIP archive", "unpack it: unzip {name}"),
)


def require_log(path: Path) -> None:
    """Raise `InputError` if a file is of another known kind than a log, whatever its name is."""
    if path.is_file() and (other := _other_kind(path, _head(path))):
        raise InputError(
            f"{path} {other[0]}", code="file.other-kind", expected="an MCAP log", remedy=other[1]
        )


def require_video(path: Path) -> None:
    """Raise `InputError` for what cannot be a video: no file, an empty one, a text, a log, an archive."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise InputError(f"{path} is not a file", code="file.not-a-file", expected=_EXPECTED)
    except OSError as error:
        raise not_read(path, error) from None
    head = _head(path)
    if not head:
        raise empty(path, _EXPECTED, "copy it again")
    if head.startswith(b"\x89MCAP"):
        raise InputError(
            f"{path} is an MCAP log under the name of a video",
            code="file.other-kind",
            expected=_EXPECTED,
            remedy="rename it to end in .mcap",
        )
    what, remedy = _other_kind(path, head) or ("is a text file" if _is_text(head) else "", "check the path")
    if what:
        raise InputError(f"{path} {what}", code="file.other-kind", expected=_EXPECTED, remedy=remedy)


def decoding_error(path: Path) -> InputError:
    """The error for a file that passed `require_video`, and of which no picture could be decoded."""
    if not _is_container(_head(path)):
        return InputError(
            f"{path} cannot be decoded",
            code="film.not-decoded",
            expected=_EXPECTED,
            remedy="convert it, for instance with ffmpeg to .mp4",
        )
    return InputError(
        f"{path} is a video without a picture that can be decoded",
        code="film.not-decoded",
        expected=_EXPECTED,
        found=f"{path.stat().st_size} bytes; it was cut off, or its codec is not known here",
        remedy="copy it again, or convert it, for instance with ffmpeg to .mp4",
    )


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_HEAD_BYTES)
    except OSError as error:
        raise not_read(path, error) from None


def _other_kind(path: Path, head: bytes) -> tuple[str, str] | None:
    """What a file of another kind is, and what to do with it."""
    found = next(((what, remedy) for first, what, remedy in _OTHER_KINDS if head.startswith(first)), None)
    return found and (found[0], found[1].format(name=path.name))


def _is_text(head: bytes) -> bool:
    try:
        text = head[: head.rfind(b"\n") + 1 or None].decode("utf-8-sig")
    except UnicodeDecodeError:
        return False
    return all(c.isprintable() or c in "\t\r\n\f" for c in text)


def _is_container(head: bytes) -> bool:
    """Whether the file begins as MP4 and MOV, AVI, or WebM and Matroska do."""
    return head[4:8] == b"ftyp" or head[:4] == b"RIFF" or head[:4] == b"\x1aE\xdf\xa3"
