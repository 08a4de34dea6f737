"""Why a file gives no pictures as a video: one sentence for each cause."""

from __future__ import annotations

import stat
from pathlib import Path

from eldir.errors import InputError

_EXPECTED = "a video, a folder of pictures or an .mcap log"
_HEAD = 4096  # bytes that tell what a file is


def unreadable(path: Path) -> InputError:
    """The error for a file of which no frame could be decoded."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            return InputError(f"{path} is no file", expected=_EXPECTED)
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        return InputError(f"cannot read {path}: {error.strerror or error}", remedy="check its permissions")
    what, found, remedy = _cause(head, status.st_size)
    return InputError(f"{path} {what}", expected=_EXPECTED, found=found, remedy=remedy)


def _cause(head: bytes, size: int) -> tuple[str, str | None, str]:
    """What is wrong with a file that begins so, what was found, and what to do."""
    if not head:
        return "is empty", "0 bytes", "copy it again"
    if head.startswith(b"\x89MCAP"):
        return "is an MCAP log under the name of a video", None, "rename it to end in .mcap"
    if _is_text(head):
        return "is a text file", None, "check the path"
    if _is_container(head):
        return (
            "is a video without a picture that can be decoded",
            f"{size} bytes; it was cut off, or its codec is not known here",
            "copy it again, or convert it, for instance with ffmpeg to .mp4",
        )
    return "cannot be decoded", None, "convert it, for instance with ffmpeg to .mp4"


def _is_text(head: bytes) -> bool:
    try:
        text = head[: head.rfind(b"\n") + 1 or None].decode("utf-8-sig")
    except UnicodeDecodeError:
        return False
    return all(c.isprintable() or c in "\t\r\n\f" for c in text)


def _is_container(head: bytes) -> bool:
    """Whether the file begins as MP4 and MOV, AVI, or WebM and Matroska do."""
    return head[4:8] == b"ftyp" or head[:4] == b"RIFF" or head[:4] == b"\x1aE\xdf\xa3"
