"""Reading and writing files: a file is written completely or not at all, and is not overwritten by
accident."""

from __future__ import annotations

import logging
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from eldir.core.json_text import LARGEST, parse_json, too_large
from eldir.errors import EldirError, InputError, not_read, not_written

_logger = logging.getLogger(__name__)


def write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write a file completely or not at all: first under a temporary name beside `path`, then renamed."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(name, 0o644)
            os.replace(name, path)
            _logger.debug("wrote %s (%d bytes)", path, len(data))
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise not_written(path, error, "choose another place or make room there") from None


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, as `write_bytes` does; bytes of a file's name that are none are escaped."""
    write_bytes(path, text.encode(errors="backslashreplace"))


def require_new(*paths: Path | None) -> None:
    """Raise `EldirError` if one of the paths exists already or cannot be written, or two are the same. Call
    this before long work."""
    named: list[Path] = []
    for path in paths:
        if path is None:
            continue
        if path.absolute() in named:
            problem = f"{path} is named twice as an output"
            raise EldirError(problem, code="file.named-twice", remedy="name one file for each")
        named.append(path.absolute())
        if path.exists():
            problem = f"{path} exists already"
            raise EldirError(problem, code="file.exists", remedy="name another one or remove it")
        above = next(p for p in path.absolute().parents if p.exists())
        if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
            why = "must not be written in" if above.is_dir() else "is no folder"
            raise not_written(path, f"{above} {why}", "choose another place")


def require_ending(option: str, path: Path | None, *endings: str) -> None:
    """Raise `InputError` if the file that an option names does not end as its contents demand."""
    if path is not None and path.suffix.lower() not in endings:
        expected = f"a name that ends in {' or '.join(endings)}"
        problem = f"invalid file extension of {option}"
        raise InputError(problem, code="file.wrong-extension", expected=expected, found=str(path))


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A folder that is written completely or not at all: filled under a temporary name, renamed at the end.

    Raises `EldirError` if `path` exists already.
    """
    require_new(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise not_written(path, error, "choose another place") from None
    try:
        yield draft
        draft.chmod(0o755)
        draft.replace(path)
        _logger.info("wrote the folder %s", path)
    except OSError as error:
        shutil.rmtree(draft, ignore_errors=True)
        raise not_written(path, error) from None
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def read_file(path: Path, most: int = LARGEST, remedy: str = "check the path") -> bytes:
    """The bytes of a file. Raises `InputError` if it is missing (with that remedy), is no regular file, or
    has more than `most` bytes."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a named pipe would wait for ever
        with os.fdopen(handle, "rb") as file:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise InputError(f"{path} is not a file", code="file.not-a-file", remedy=remedy)
            data = file.read(most + 1)
    except (OSError, ValueError) as error:
        raise not_read(path, error, remedy) from None
    if len(data) > most:
        raise too_large(str(path), most)
    _logger.debug("read %s (%d bytes)", path, len(data))
    return data


def read_json(path: Path, format_name: str, known: tuple[str, ...], most: int = LARGEST) -> dict[str, Any]:
    """The object in a JSON file. Raises `InputError` if its "format" is not one of `known`."""
    values = parse_json(read_file(path, most), str(path), most)
    found = values.get("format") if isinstance(values, dict) else None
    if not isinstance(found, str) or found not in known:
        raise InputError(
            f"{path} is not the right kind of file",
            code="file.other-format",
            expected=f'"format": "{format_name}"',
            found=repr(found)[:60],
        )
    return values
