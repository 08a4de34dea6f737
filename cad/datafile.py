"""Validated YAML files: the kit's own data and the user's."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from eldir.errors import InputError

Length = Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)]
Gap = Annotated[float, Field(ge=0, le=5, allow_inf_nan=False)]


class Section(BaseModel):
    """A part of a file; unknown names are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


_Model = TypeVar("_Model", bound=BaseModel)


def own_data(name: str) -> Path:
    """A file that comes with the kit."""
    return Path(str(resources.files("cad") / "data" / name))


def load(path: Path, model: type[_Model]) -> _Model:
    """The file as `model`; anything wrong in it is named."""
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path} does not exist", remedy="check the path") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is damaged", expected="YAML", found=str(error)) from None
    return validated(model, values, str(path))


def validated(model: type[_Model], values: object, where: str) -> _Model:
    """Values as `model`; `where` tells a person what they are."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "the whole"
        message = first["msg"].removeprefix("Value error, ")
        raise InputError(f"{where}: {field}: {message}", remedy="correct the file") from None
