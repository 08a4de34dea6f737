"""Files that are attached to a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from eldir.core.json_text import parse_json
from eldir.core.yaml_files import parse_yaml
from eldir.errors import EldirError, InputError, damaged

_File = TypeVar("_File")


def read_attachment(
    attachments: Mapping[str, bytes], recording: Path | str, name: str, build: Callable[[Any], _File]
) -> _File | None:
    """Build an object from the attached JSON or YAML file of that name; None if there is none.

    Raises `InputError` for a damaged file.
    """
    if name not in attachments:
        return None
    data = attachments[name]
    try:
        return build(parse_json(data, name) if name.endswith(".json") else parse_yaml(data, name))
    except EldirError as error:
        raise InputError(
            f"{name} in {recording} is damaged", code=error.code, key=error.key, found=str(error)
        ) from None
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        found = f"{type(error).__name__}: {error}".splitlines()[0]
        raise damaged(f"{name} in {recording}", found=found) from None
