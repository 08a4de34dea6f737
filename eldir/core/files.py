"""Reading and writing files. A file is written completely or not at all, and not overwritten by accident.

JSON that others wrote is bounded in size, depth and number of values.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any

from eldir.errors import EldirError, InputError, damaged, empty, not_read, not_written

MAX_JSON_BYTES = 8 << 20
"""Largest text [bytes]; the files of this program have some ten thousand."""
_MAX_DEPTH = 64
_BYTES_A_VALUE = 8  # so that a text of the largest size holds a million values
_WHOLE = 1 << 63
_AGAIN = "write it again"
_logger = logging.getLogger(__name__)


def parse_json(data: bytes | str, where: str, most: int = MAX_JSON_BYTES) -> Any:
    """The values in a JSON text of at most `most` bytes; `where` names it in an error.

    Raises `InputError` for text that is not JSON, a duplicate name, and numbers that are not finite.
    """
    if len(data) > most:
        raise too_large_error(where, most)
    if not data.strip():
        raise empty(where, "JSON", _AGAIN)
    try:
        text = data if isinstance(data, str) else data.decode("utf-8-sig")
        values = json.loads(
            text,
            object_pairs_hook=_object,
            parse_constant=_no_number,
            parse_float=_finite,
            parse_int=_integer,
        )
        _check_extent(values, most // _BYTES_A_VALUE)
    except RecursionError:
        raise damaged(where, "JSON", f"more than {_MAX_DEPTH} levels", _AGAIN) from None
    except UnicodeDecodeError:
        raise damaged(
            where, "JSON", "bytes that are not UTF-8 text", "check that it is the right file"
        ) from None
    except ValueError as error:
        raise damaged(where, "JSON", str(error)[:120], _AGAIN) from None
    return values


def too_large_error(where: str, most: int) -> InputError:
    """The error for a file of more than `most` bytes."""
    return InputError(
        f"{where} is too large",
        code="file.too-large",
        expected=f"at most {most >> 10} KiB",
        remedy="check that it is the right file",
    )


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"duplicate name {next(n for n in names if names.count(n) > 1)!r}")
    return values


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is not a number")


def _finite(text: str) -> float:
    value = float(text)
    if not isfinite(value):
        raise ValueError(f"the number {text[:20]} is too large")
    return value


def _integer(text: str) -> int:
    if len(text) > 20 or not -_WHOLE <= (value := int(text)) < _WHOLE:
        raise ValueError(f"the number {text[:20]}... is too large")
    return value


def _check_extent(values: Any, most: int) -> None:
    level, depth, count = [values], 0, 0
    while level:
        count, depth = count + len(level), depth + 1
        if depth > _MAX_DEPTH:
            raise ValueError(f"more than {_MAX_DEPTH} levels")
        if count > most:
            raise ValueError(f"more than {most} values")
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner += value.values()
            elif isinstance(value, list):
                inner += value
        level = inner


def write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write a file completely or not at all: first under a temporary name beside `path`, then renamed.

    A file that is replaced keeps who may read it: a rig file may have passwords.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o644
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(name, mode)
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
            problem = f"{path} is given twice as an output"
            raise EldirError(problem, code="file.named-twice", remedy="name one file for each")
        named.append(path.absolute())
        if path.exists():
            problem = f"{path} exists already"
            raise EldirError(problem, code="file.exists", remedy="choose another name or remove it")
        require_folder(path)


def require_folder(path: Path) -> None:
    """Raise `EldirError` if nothing can be written at `path`, whose folder need not exist yet. Call this
    before long work."""
    above = next(p for p in path.absolute().parents if p.exists())
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        why = "is not writable" if above.is_dir() else "is not a folder"
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


def read_file(path: Path, most: int = MAX_JSON_BYTES, remedy: str = "check the path") -> bytes:
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
        raise too_large_error(str(path), most)
    _logger.debug("read %s (%d bytes)", path, len(data))
    return data


def read_json(
    path: Path, format_name: str, known: tuple[str, ...], most: int = MAX_JSON_BYTES
) -> dict[str, Any]:
    """The object in a JSON file. Raises `InputError` if its "format" is not one of `known`."""
    values = parse_json(read_file(path, most), str(path), most)
    found = values.get("format") if isinstance(values, dict) else None
    if not isinstance(found, str) or found not in known:
        raise InputError(
            f"invalid format of {path}",
            code="file.other-format",
            expected=f'"format": "{format_name}"',
            found=repr(found)[:60],
        )
    return values
