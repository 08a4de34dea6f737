"""Reading the data files of the kit and of the user; lengths in millimetres."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import Field

from eldir.core.validation import Section, validated
from eldir.core.yaml_files import read_yaml

Length = Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)]
Gap = Annotated[float, Field(ge=0, le=5, allow_inf_nan=False)]
_Section = TypeVar("_Section", bound=Section)


def own_data(name: str) -> Path:
    """Path of a data file of the kit."""
    return Path(str(resources.files("eldir_cad.kit") / "data" / name))


def load(path: Path, model: type[_Section]) -> _Section:
    """The file's values, validated as `model`. Raises `InputError` that names the wrong value."""
    return validated(model, read_yaml(path), str(path))
