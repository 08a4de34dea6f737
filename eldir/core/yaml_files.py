"""YAML files that people write. Errors name the wrong value and its place in the file."""

from __future__ import annotations

import re
from math import isfinite
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict

from eldir.core.files import read_file
from eldir.core.json_text import too_large
from eldir.core.validation import STRICT, Plain
from eldir.errors import damaged

LARGEST = 64 << 10
"""Largest YAML file [bytes]; a rig file has about two thousand."""
_DEEPEST = 16
_MOST_VALUES = 2000
_LONGEST_NUMBER = 30  # characters
_NAME = re.compile(r"\w{1,40}")
_WHOLE = re.compile(r"[-+]?(0|[1-9][0-9]*)")


class Section(Plain, BaseModel):
    """A part of a file that people write; unknown names are refused, and true and false where a number is
    meant."""

    model_config = ConfigDict(frozen=True, **STRICT)


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
        raise damaged(where, "YAML", _problem(error)) from None


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
