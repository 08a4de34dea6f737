"""JSON that others wrote: bounded in size, depth and number of values, without anything that is no JSON."""

from __future__ import annotations

import json
from math import isfinite
from typing import Any

from eldir.errors import InputError, damaged, empty

LARGEST = 8 << 20
"""Largest text [bytes]; the files of this program have some ten thousand."""
_DEEPEST = 64
_BYTES_A_VALUE = 8  # so that a text of the largest size holds a million values
_WHOLE = 1 << 63
_AGAIN = "write it again"


def parse_json(data: bytes | str, where: str, most: int = LARGEST) -> Any:
    """The values in a JSON text of at most `most` bytes; `where` names it in an error.

    Raises `InputError` for what is no JSON, a name that is there twice, and numbers that are not finite.
    """
    if len(data) > most:
        raise too_large(where, most)
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
        raise damaged(where, "JSON", f"more than {_DEEPEST} levels", _AGAIN) from None
    except UnicodeDecodeError:
        raise damaged(where, "JSON", "bytes that are no text", "check that it is the right file") from None
    except ValueError as error:
        raise damaged(where, "JSON", str(error)[:120], _AGAIN) from None
    return values


def too_large(where: str, most: int) -> InputError:
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
        raise ValueError(f"{next(n for n in names if names.count(n) > 1)!r} is there twice")
    return values


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no number")


def _finite(text: str) -> float:
    value = float(text)
    if not isfinite(value):
        raise ValueError(f"{text[:20]} is too large a number")
    return value


def _integer(text: str) -> int:
    if len(text) > 20 or not -_WHOLE <= (value := int(text)) < _WHOLE:
        raise ValueError(f"{text[:20]}... is too large a number")
    return value


def _check_extent(values: Any, most: int) -> None:
    level, depth, count = [values], 0, 0
    while level:
        count, depth = count + len(level), depth + 1
        if depth > _DEEPEST:
            raise ValueError(f"more than {_DEEPEST} levels")
        if count > most:
            raise ValueError(f"more than {most} values")
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner += value.values()
            elif isinstance(value, list):
                inner += value
        level = inner
