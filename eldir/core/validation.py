"""Values checked by pydantic. An invalid value gives one line: the place, what was expected and found."""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
from abc import ABCMeta
from dataclasses import fields, is_dataclass, replace
from datetime import date
from functools import cache
from itertools import pairwise
from types import NoneType, UnionType
from typing import Any, ClassVar, Self, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler, TypeAdapter, ValidationError
from pydantic.dataclasses import is_pydantic_dataclass, rebuild_dataclass
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from eldir.errors import EldirError, InputError

STRICT = ConfigDict(
    strict=True,
    extra="forbid",
    allow_inf_nan=False,
    ser_json_inf_nan="constants",
    serialize_by_alias=True,
    validate_by_name=True,
)
"""A string or `true` is not accepted as a number, and unknown entries are refused. An alias is the name in
files."""
_Kind = TypeVar("_Kind")
_PRIVATE = {half: half + 0x102000 for half in range(0xD800, 0xE000)}
"""Half characters, by which Python has bytes that are no UTF-8, as characters of the last private plane."""


@cache
def adapter(kind: Any) -> TypeAdapter[Any]:
    """Pydantic's reader and writer of a type."""
    if is_pydantic_dataclass(kind):
        # Of a class that was never used `TypeAdapter` ignores parts of the configuration.
        rebuild_dataclass(kind)
    return TypeAdapter(kind)


def validate(kind: type[_Kind], values: object, where: str, remedy: str = "correct the file") -> _Kind:
    """Convert plain values, as JSON has them, into an object of this kind; `where` names them in an error.

    A string or `true` is not accepted as a number. Raises `InputError` for the first invalid value.
    """
    try:
        # pydantic takes lists for tuples in JSON alone, and no name of a file that is not UTF-8
        text = json.dumps(_upgrade_values(kind, values), default=_date_text, ensure_ascii=False)
        sound = text.translate(_PRIVATE)
        read = adapter(kind).validate_json(sound, strict=True, by_alias=True, by_name=False)  # type: ignore[arg-type]
        return cast(_Kind, read if sound == text else _restore_surrogates(read))
    except ValidationError as error:
        raise _input_error(error, kind, where, ": ", remedy) from None
    except EldirError as error:
        code = _inconsistency_code(error, kind)
        raise InputError(f"{where} is invalid: {error}", code=code, key=error.key) from None
    except KeyError as error:
        name, code = str(error.args[0]), f"{_code_prefix(kind)}.missing-key"
        raise InputError(f"{where}: {name} is missing", code=code, key=name, remedy=remedy) from None
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:  # of an `upgrade`
        found = f"an invalid value: {error}"[:200]
        raise InputError(f"{where} is damaged", code="file.damaged", found=found, remedy=remedy) from None


def _restore_surrogates(value: Any) -> Any:
    """What was read, with half characters in its texts again."""
    match value:
        case str():
            return value.translate({private: half for half, private in _PRIVATE.items()})
        case dict():
            return {_restore_surrogates(key): _restore_surrogates(inner) for key, inner in value.items()}
        case list() | tuple() | frozenset() if not hasattr(value, "_fields"):
            return type(value)(map(_restore_surrogates, value))
        case Plain() if is_dataclass(value):
            return replace(
                value, **{f.name: _restore_surrogates(getattr(value, f.name)) for f in fields(value)}
            )
    return value


def _upgrade_values(kind: Any, values: Any) -> Any:
    """The values of a file of any age as this version has them, at every depth."""
    if isinstance(kind, type) and issubclass(kind, Plain) and isinstance(values, dict):
        values, inner = kind.upgrade(values), _entry_types(kind)  # type: ignore[arg-type]
        if kind.OPTIONAL is not None and (missing := set(inner) - kind.OPTIONAL - set(values)):
            raise KeyError(min(missing))
        return {name: _upgrade_values(inner.get(name), value) for name, value in values.items()}
    of = [k for k in get_args(kind) if k not in (NoneType, Ellipsis, str)]
    if len(of) == 1 and isinstance(values, list):
        return [_upgrade_values(of[0], value) for value in values]
    if len(of) == 1 and get_origin(kind) is dict and isinstance(values, dict):
        return {name: _upgrade_values(of[0], value) for name, value in values.items()}
    return (
        _upgrade_values(of[0], values) if len(of) == 1 and get_origin(kind) in (Union, UnionType) else values
    )


@cache
def _entry_types(kind: Any) -> dict[str, Any]:
    """Types of the entries of a class, by their names in a file."""
    hints = get_type_hints(kind)
    return {_file_key(kind, n): hint for n, hint in hints.items() if get_origin(hint) is not ClassVar}


def _file_key(kind: Any, name: str) -> str:
    """The name that a field has in files."""
    known = getattr(kind, "__pydantic_fields__", {})
    return (known[name].alias if name in known else None) or name


class Checked(ABCMeta):
    """Metaclass of dataclasses whose construction raises `InputError`; NumPy's numbers are welcome there.

    Pydantic writes `__init__` anew when a class is first used, so a wrapper around it would be lost.
    """

    def __call__(cls, *args: Any, **given: Any) -> Any:
        if not hasattr(cls, "__pydantic_fields__"):  # a dataclass of the standard library
            return super().__call__(*args, **given)
        try:
            return super().__call__(
                *map(_python_number, args), **{name: _python_number(value) for name, value in given.items()}
            )
        except ValidationError as error:
            names = [f.name for f in fields(cls) if f.init]  # type: ignore[arg-type]
            raise _input_error(error, cls, cls.__name__, ".", None, names) from None
        except InputError as error:  # of entries that do not fit together
            error.code = _inconsistency_code(error, cls)
            raise


def _python_number(value: object) -> object:
    """A number of NumPy's as one of Python's."""
    return value.item() if isinstance(value, np.generic) else value


def _code_prefix(kind: type) -> str:
    """The beginning of the codes of a record's errors: the name of its format, or of its class."""
    if known := getattr(kind, "FORMAT", None):
        return str(known).removeprefix("eldir-").partition("/")[0]
    return re.sub(r"(?<!^)(?=[A-Z])", "-", kind.__name__).lower().removesuffix("-config")


def _inconsistency_code(error: EldirError, kind: type) -> str:
    """The code of an error that a record raised: where that names no fault of its own, the record's."""
    return f"{_code_prefix(kind)}.inconsistent" if error.code.partition(".")[0] == "input" else error.code


def _input_error(
    error: ValidationError,
    kind: type,
    where: str,
    joint: str,
    remedy: str | None,
    names: list[str] | None = None,
) -> InputError:
    """The first of pydantic's findings; `names` of the arguments that were given by position."""
    code = _code_prefix(kind)
    first = error.errors(include_url=False)[0]
    place = list(first["loc"])
    if names is not None and place and isinstance(place[0], int) and place[0] < len(names):
        place[0] = names[place[0]]
    if place and place[-1] == "[key]":  # pydantic's sign that the name of an entry is wrong, not its value
        place.pop()
    at = ".".join(map(str, place))
    what = f"{where}{joint}{at}" if at else where
    match first["type"]:
        case "value_error":  # our own words, such as of entries that do not fit together
            reason = first["msg"].removeprefix("Value error, ")
            return InputError(f"{what}: {reason}", code=f"{code}.inconsistent", key=at or None, remedy=remedy)
        case "unexpected_positional_argument":
            expected = ", ".join(names or [])
            return InputError(
                f"too many arguments for {where}", code=f"{code}.unknown-key", expected=expected
            )
        case "multiple_argument_values":
            problem = f"{what} is given twice, by position and by name"
            return InputError(problem, code=f"{code}.inconsistent", key=at)
        case "missing" | "missing_argument":
            return InputError(f"{what} is missing", code=f"{code}.missing-key", key=at, remedy=remedy)
        case "extra_forbidden" | "unexpected_keyword_argument":
            problem = f"{where}: unknown entry {at}"
            return InputError(problem, code=f"{code}.unknown-key", key=at, remedy=remedy)
    return InputError(
        _invalid(where, joint, at),
        code=f"{code}.wrong-value",
        key=at or None,
        expected=_expected_text(first["msg"]),
        found=repr(first.get("ctx", {}).get("actual_length", first["input"]))[:60],
        remedy=remedy,
    )


def _invalid(where: str, joint: str, at: str) -> str:
    """The first words of the error for an invalid entry of a file or an invalid argument."""
    if not at:
        return f"{where}: invalid contents"
    return f"invalid {where}.{at}" if joint == "." else f"{where}{joint}invalid {at}"


def _date_text(value: object) -> str:
    """A date, which YAML has without quotes."""
    if isinstance(value, date):
        return value.isoformat()
    raise TypeError(f"{value!r} is not a plain value")


def _expected_text(message: str) -> str:
    """What pydantic expects, in plain English."""
    wanted = re.sub("^[A-Z][a-z]+ should (be|have|match) |, not [0-9]+$| after validation", "", message)
    return "named entries" if "dictionary" in wanted or "object" in wanted else wanted


class Plain:
    """Base of what is read from plain values and written as such, by the annotations of its fields.

    In its JSON Schema each entry is described by the text below its field.
    """

    OPTIONAL: ClassVar[frozenset[str] | None] = None
    """Entries that a file may lack; it must have all others, also those with a default here. None: those with
    a default."""

    def to_json(self) -> dict[str, Any]:
        """Plain values as in a file."""
        return cast(dict[str, Any], adapter(type(self)).dump_python(self, mode="json"))  # type: ignore[arg-type]

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """The inverse of `to_json`, for older files too. Raises `InputError` for an invalid value."""
        return validate(cls, values, cls.__name__)

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
        for name, text in field_texts(cls).items():
            if (entry := _file_key(cls, name)) in entries:
                entries[entry]["description"] = text
        if cls.OPTIONAL is not None:
            resolved["required"] = [name for name in entries if name not in cls.OPTIONAL]
        return schema


class Section(Plain, BaseModel):
    """A part of a file that people write; unknown names are refused, and true and false where a number is
    meant."""

    model_config = ConfigDict(frozen=True, **STRICT)


def field_texts(cls: type) -> dict[str, str]:
    """The texts below the fields of a class and of those from which it is derived."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if is_dataclass(base) or (issubclass(base, Plain) and base is not Plain):
            found |= _module_texts(base.__module__)[base.__qualname__]
    return found


@cache
def _module_texts(module: str) -> dict[str, dict[str, str]]:
    """The texts below the fields of each class of a module. Python reads the whole module for the source of
    one class."""
    texts: dict[str, dict[str, str]] = {}

    def read(node: ast.AST, scope: str) -> None:
        for inner in ast.iter_child_nodes(node):
            name = f"{scope}{getattr(inner, 'name', '')}"
            if isinstance(inner, ast.ClassDef):
                texts[name] = _own_texts(inner)
                read(inner, f"{name}.")
            elif isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef):
                read(inner, f"{name}.<locals>.")
            elif isinstance(inner, ast.stmt):
                read(inner, scope)

    read(ast.parse(inspect.getsource(sys.modules[module])), "")
    return texts


def _own_texts(declared: ast.ClassDef) -> dict[str, str]:
    return {
        ast.unparse(entry.target): " ".join(ast.literal_eval(below.value).split())
        for entry, below in pairwise(declared.body)
        if isinstance(entry, ast.AnnAssign) and isinstance(below, ast.Expr)
    }
