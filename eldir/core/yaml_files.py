"""YAML files that people write. Errors name the wrong value and its place in the file."""

from __future__ import annotations

import ast
import inspect
import re
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler, ValidationError, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from eldir.core.files import read_file
from eldir.core.json_text import too_large
from eldir.errors import InputError

LARGEST = 64 << 10
"""Largest YAML file [bytes]; a rig file has about two thousand."""
_DEEPEST = 16
_MOST_VALUES = 2000
_LONGEST_NUMBER = 30  # characters
_NAME = re.compile(r"\w{1,40}")
_WHOLE = re.compile(r"[-+]?(0|[1-9][0-9]*)")

_Model = TypeVar("_Model", bound=BaseModel)


class Section(BaseModel):
    """A part of a file; unknown names are refused, and true and false where a number is meant."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """The schema, each entry described by the text below it in the class.

        pydantic's own `use_attribute_docstrings` reads the source at every import.
        """
        schema = handler(core)
        entries = handler.resolve_ref_schema(schema)["properties"]
        for name, text in _described(cls).items():
            if name in entries:
                entries[name]["description"] = text
        return schema

    @model_validator(mode="before")
    @classmethod
    def _no_truth_as_a_number(cls, values: Any) -> Any:
        for name, value in values.items() if isinstance(values, dict) else ():
            field = cls.model_fields.get(name)
            if isinstance(value, bool) and field is not None and not _takes_truth(field.annotation):
                raise ValueError(f"{name} is {str(value).lower()}, which is no value for it")
        return values


def _described(cls: type) -> dict[str, str]:
    """The texts below the entries of a class and of those from which it is derived."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if issubclass(base, Section) and base is not Section:
            [declared] = ast.parse(inspect.getsource(base)).body
            assert isinstance(declared, ast.ClassDef)
            for entry, below in pairwise(declared.body):
                if isinstance(entry, ast.AnnAssign) and isinstance(below, ast.Expr):
                    found[ast.unparse(entry.target)] = " ".join(ast.literal_eval(below.value).split())
    return found


def _takes_truth(kind: Any) -> bool:
    return kind is bool or kind is Any or any(_takes_truth(inner) for inner in get_args(kind))


def read_yaml(path: Path, remedy: str = "check the path") -> Any:
    """Contents of a YAML file, without a check of their values; `remedy` goes into the error for a missing
    file."""
    return parse_yaml(read_file(path, LARGEST, remedy), str(path))


def parse_yaml(data: bytes, where: str) -> Any:
    """The values in a YAML text; `where` names it in an error.

    Raises `InputError` for what is no YAML, for aliases, a name that is there twice, numbers that are not
    finite, and more bytes, levels or values than a file of this program has.
    """
    if len(data) > LARGEST:
        raise too_large(where, LARGEST)
    try:
        return _load(data.decode("utf-8-sig"))
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        found = _problem(error)
        raise InputError(f"{where} is damaged", expected="YAML", found=found) from None


def _problem(error: Exception) -> str:
    """What is wrong and where, without an excerpt of the file."""
    if isinstance(error, UnicodeDecodeError):
        return "bytes that are no text"
    place = getattr(error, "problem_mark", None)
    if not isinstance(error, yaml.MarkedYAMLError) or place is None:
        return " ".join(str(error).split())[:200]
    return f"{error.problem} in line {place.line + 1}, column {place.column + 1}"


def _load(text: str) -> Any:
    loader = _PlainLoader(text)
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()


class _PlainLoader(yaml.SafeLoader):
    """Plain values only: nothing that grows when it is read."""

    def __init__(self, text: str):
        super().__init__(text)
        self._depth = self._count = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _refused("anchors and aliases are not allowed", event)
        self._depth, self._count = self._depth + 1, self._count + 1
        if self._depth > _DEEPEST:
            raise _refused(f"more than {_DEEPEST} levels", event)
        if self._count > _MOST_VALUES:
            raise _refused(f"more than {_MOST_VALUES} values", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for i, name in enumerate(names):
            if name in names[:i]:
                shown = repr(name) if _NAME.fullmatch(name) else "a name"  # which may be a secret
                raise _refused(f"{shown} is there twice", node)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: Any) -> int:
        if len(node.value) > _LONGEST_NUMBER:
            raise _refused("a number is too long", node)
        if not _WHOLE.fullmatch(node.value):  # YAML reads 010 as 8, and 1:30 as 90
            raise _refused(f"{node.value!r} is no plain decimal number", node)
        return int(node.value)

    def construct_yaml_float(self, node: Any) -> float:
        if len(node.value) > _LONGEST_NUMBER or not isfinite(value := super().construct_yaml_float(node)):
            raise _refused(f"{node.value[:_LONGEST_NUMBER]!r} is not a finite number", node)
        if set(node.value) & set(":_"):
            raise _refused(f"{node.value!r} is no plain decimal number", node)
        return float(value)


_PlainLoader.add_constructor("tag:yaml.org,2002:int", _PlainLoader.construct_yaml_int)
_PlainLoader.add_constructor("tag:yaml.org,2002:float", _PlainLoader.construct_yaml_float)


def _refused(problem: str, at: Any) -> yaml.YAMLError:
    return yaml.constructor.ConstructorError(None, None, problem, at.start_mark)


def _expected(message: str) -> str:
    """What Pydantic expects, in our words."""
    wanted = message.removeprefix("Input should be ")
    return "named entries" if "dictionary" in wanted else wanted


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
        if first["type"] == "missing":
            raise InputError(f"{where}: {place} is missing", remedy=remedy) from None
        if first["type"] == "extra_forbidden":
            raise InputError(f"{where}: no entry has the name {place}", remedy=remedy) from None
        raise InputError(
            f"{where}: {place or 'the whole'} is wrong",
            expected=_expected(first["msg"]),
            found=repr(first["input"])[:60],
            remedy=remedy,
        ) from None
