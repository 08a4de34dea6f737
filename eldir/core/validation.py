"""Values checked by pydantic; what it finds wrong is one line: the place, what was expected and found."""

from __future__ import annotations

import ast
import inspect
import json
import re
from collections.abc import Callable
from dataclasses import fields
from datetime import date
from functools import cache, wraps
from itertools import pairwise
from typing import Any, Self, TypeVar, cast

from pydantic import ConfigDict, GetJsonSchemaHandler, TypeAdapter, ValidationError
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from eldir.errors import InputError

STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
"""Strings are no numbers, and true is none; unknown entries are refused."""
_Kind = TypeVar("_Kind")


@cache
def adapter(kind: Any) -> TypeAdapter[Any]:
    """Pydantic's reader and writer of a type."""
    return TypeAdapter(kind)


def validated(kind: type[_Kind], values: object, where: str, remedy: str = "correct the file") -> _Kind:
    """Plain values, as JSON has them, as an object of this kind; `where` names them in an error.

    Strings are no numbers, and true is none. Raises `InputError` for the first value that is wrong.
    """
    if isinstance(values, dict) and issubclass(kind, Plain):
        values = kind.upgrade(values)
    text = json.dumps(values, default=_written)  # pydantic takes lists for tuples in JSON alone
    try:
        return cast(_Kind, adapter(kind).validate_json(text, strict=True))  # type: ignore[arg-type]
    except ValidationError as error:
        raise _input_error(error, where, ": ", remedy) from None
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def raising_input_errors(cls: type[_Kind]) -> Callable[..., None]:
    """The constructor of a pydantic dataclass, whose errors are `InputError`."""
    construct: Callable[..., None] = cls.__init__
    names = [f.name for f in fields(cls) if f.init]  # type: ignore[arg-type]

    @wraps(construct)
    def __init__(self: Any, *args: Any, **given: Any) -> None:
        try:
            construct(self, *args, **given)
        except ValidationError as error:
            raise _input_error(error, type(self).__name__, ".", None, names) from None

    return __init__


def _input_error(
    error: ValidationError, where: str, joint: str, remedy: str | None, names: list[str] | None = None
) -> InputError:
    """The first of pydantic's findings; `names` of the arguments that were given by position."""
    first = error.errors(include_url=False)[0]
    place = list(first["loc"])
    if names is not None and place and isinstance(place[0], int) and place[0] < len(names):
        place[0] = names[place[0]]
    at = ".".join(map(str, place))
    what = f"{where}{joint}{at}" if at else where
    match first["type"]:
        case "value_error":  # our own words, such as of entries that do not fit together
            return InputError(f"{what}: {first['msg'].removeprefix('Value error, ')}", remedy=remedy)
        case "missing" | "missing_argument":
            return InputError(f"{what} is missing", remedy=remedy)
        case "extra_forbidden" | "unexpected_keyword_argument":
            return InputError(f"{where}: no entry has the name {at}", remedy=remedy)
    return InputError(
        f"{what} is wrong" if at else f"{where}: the whole is wrong",
        expected=_expected(first["msg"]),
        found=repr(first.get("ctx", {}).get("actual_length", first["input"]))[:60],
        remedy=remedy,
    )


def _written(value: object) -> str:
    """A date, which YAML has without quotes."""
    if isinstance(value, date):
        return value.isoformat()
    raise TypeError(f"{value!r} is no plain value")


def _expected(message: str) -> str:
    """What pydantic expects, in our words."""
    wanted = re.sub("^[A-Z][a-z]+ should (be|have|match) |, not [0-9]+$| after validation", "", message)
    return "named entries" if "dictionary" in wanted or "object" in wanted else wanted


class Plain:
    """Base of what is read from plain values and written as such, by the annotations of its fields.

    In its JSON Schema each entry is described by the text below its field.
    """

    def to_json(self) -> dict[str, Any]:
        """Plain values as in a file."""
        return cast(dict[str, Any], adapter(type(self)).dump_python(self, mode="json"))  # type: ignore[arg-type]

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """The inverse of `to_json`, for older files too. Raises `InputError` for what is wrong."""
        return validated(cls, values, cls.__name__)

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        """The values of an older file as this version has them."""
        return values

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        # pydantic's own `use_attribute_docstrings` reads the source at every import.
        schema = handler(core)
        resolved = handler.resolve_ref_schema(schema)
        resolved["description"] = " ".join((inspect.getdoc(cls) or "").split())
        entries = resolved["properties"]
        for name, text in _field_texts(cls).items():
            if name in entries:
                entries[name]["description"] = text
        return schema


def _field_texts(cls: type) -> dict[str, str]:
    """The texts below the fields of a class and of those from which it is derived."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if issubclass(base, Plain) and base is not Plain:
            [declared] = ast.parse(inspect.getsource(base)).body
            assert isinstance(declared, ast.ClassDef)
            for entry, below in pairwise(declared.body):
                if isinstance(entry, ast.AnnAssign) and isinstance(below, ast.Expr):
                    found[ast.unparse(entry.target)] = " ".join(ast.literal_eval(below.value).split())
    return found
