"""YAML files that people write. Errors name the wrong value and its place in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from eldir.errors import InputError

_Model = TypeVar("_Model", bound=BaseModel)


class Section(BaseModel):
    """A part of a file; unknown names are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def read_yaml(path: Path, remedy: str = "check the path") -> Any:
    """Contents of a YAML file, without a check of their values; `remedy` goes into the error for a missing
    file."""
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path} does not exist", remedy=remedy) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read {path}: {error}") from None
    except yaml.YAMLError as error:
        raise InputError(f"{path} is damaged", expected="YAML", found=" ".join(str(error).split())) from None


def validated(model: type[_Model], values: object, where: str, remedy: str = "correct the file") -> _Model:
    """The values, validated as `model`; `where` names them in an error."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        if first["type"] == "value_error":  # our own words, such as of entries that do not fit together
            problem = first["msg"].removeprefix("Value error, ")
            raise InputError(
                f"{where}: {place}: {problem}" if place else f"{where}: {problem}", remedy=remedy
            ) from None
        raise InputError(
            f"{where}: {place or 'the whole'} is wrong",
            expected=first["msg"].removeprefix("Input should be "),
            found=repr(first["input"])[:60],
            remedy=remedy,
        ) from None
