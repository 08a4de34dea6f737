"""The one reader and writer of YAML: 1.1, as ROS reads it too. Errors name the place in the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from math import isfinite
from pathlib import Path
from typing import Any

import yaml

from eldir.core.files import read_file, too_large_error
from eldir.errors import InputError, damaged

MAX_YAML_BYTES = 64 << 10
"""Largest YAML file [bytes]; a rig file has about two thousand."""
_MAX_DEPTH = 16
_MAX_VALUES = 2000
_MAX_DIGITS = 30  # characters
_NAME = re.compile(r"\w{1,40}")
_WHOLE = re.compile(r"[-+]?(0|[1-9][0-9]*)")


def read_yaml(path: Path, remedy: str = "check the path") -> Any:
    """Contents of a YAML file, without a check of their values; `remedy` goes into the error for a missing
    file."""
    return parse_yaml(read_file(path, MAX_YAML_BYTES, remedy), str(path))


def parse_yaml(data: bytes, where: str) -> Any:
    """The values in a YAML text; `where` names it in an error.

    Raises `InputError` for text that is not YAML, for aliases, duplicate names, numbers that are not finite,
    and more bytes, levels or values than a file of this program has.
    """
    if len(data) > MAX_YAML_BYTES:
        raise too_large_error(where, MAX_YAML_BYTES)
    return _parse(data, where, _require_plain, PlainLoader)


def parse_foreign_yaml(data: bytes, where: str, remedy: str) -> Any:
    """The values in a YAML text of another program, which may use all of YAML. Raises `InputError`."""
    return _parse(data, where, lambda _: None, yaml.SafeLoader, remedy)


def dump_yaml(values: Any, **style: Any) -> str:
    """Plain values as YAML, in their order and without aliases; `style` as PyYAML has it."""
    return str(yaml.dump(values, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1 << 20, **style))


def with_entries(text: str, section: str, entries: Mapping[str, float | str | None]) -> str:
    """The text of a YAML file with these entries of a section set; all else stays, comments too.

    Raises `InputError` where the text is so unusual that this does not come out.
    """
    wanted = parse_yaml(text.encode(), "the file")
    wanted[section] = {**(wanted.get(section) or {}), **entries}
    for name, value in entries.items():
        text = _with_entry(text, (section, name), value)
    return _require_values(text, wanted, {section: dict(entries)})


def with_section(text: str, section: str, value: Any) -> str:
    """The text of a YAML file with this section replaced; all else stays, comments outside of it too.

    A file without the section gets it in place of its example, a comment "# section: {...}", or at its end.
    Raises `InputError` where the text is so unusual that this does not come out.
    """
    wanted = parse_yaml(text.encode(), "the file")
    if section not in wanted:
        example = re.compile(rf"^# {re.escape(section)}: \{{.*\}}$", re.MULTILINE)
        if not example.search(text):
            text = f"{text.rstrip()}\n# {section}: {{}}\n"
        text = example.sub(f"{section}:", text, count=1)
    wanted[section] = value
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    node = next(inner for key, inner in root.value if key.value == section)
    begin, end = node.start_mark.index, _last_leaf(node).end_mark.index
    if isinstance(value, list) and isinstance(node, yaml.SequenceNode) and not node.flow_style:
        new = ("\n" + " " * node.start_mark.column).join(f"- {_flow_text(row)}" for row in value)
    else:
        new = (" " if begin == end else "") + _flow_text(value)
    return _require_values(text[:begin] + new + text[end:], wanted, {section: value})


def _require_values(text: str, wanted: Any, changes: Mapping[str, Any]) -> str:
    """The text, if its values are the wanted ones."""
    with suppress(InputError):
        if parse_yaml(text.encode(), "the file") == wanted:
            return text
    written = dump_yaml(dict(changes), default_flow_style=True).strip()
    raise InputError("entries of the file cannot be changed", remedy=f"write them yourself: {written}")


def _flow_text(value: Any) -> str:
    """A value on one line."""
    return dump_yaml([value], default_flow_style=True).strip()[1:-1]


def _last_leaf(node: Any) -> Any:
    """The last value of a block: the block itself ends behind the comments below it."""
    while isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        node = node.value[-1][1] if isinstance(node, yaml.MappingNode) else node.value[-1]
    return node


def _with_entry(text: str, path: Sequence[str], value: Any) -> str:
    node = yaml.compose(text, Loader=yaml.SafeLoader)  # whose marks count characters
    while path and isinstance(node, yaml.MappingNode):
        inner = next((inner for key, inner in node.value if key.value == path[0]), None)
        if inner is None:
            break
        node, path = inner, path[1:]
    for name in reversed(path):
        value = {name: value}
    new = _flow_text(value)
    if not path or not isinstance(node, yaml.MappingNode):  # an entry, perhaps with nothing after the colon
        begin, end = node.start_mark.index, node.end_mark.index
        return text[:begin] + (" " if begin == end else "") + new + text[end:]
    new = new[1:-1]  # without the braces
    if not node.value:
        at = node.start_mark.index + 1
    elif node.flow_style:
        at, new = node.value[-1][1].end_mark.index, f", {new}"
    else:
        at, new = _last_leaf(node).end_mark.index, "\n" + " " * node.start_mark.column + new
        at += len(text[at:].partition("\n")[0])  # behind a comment
    return text[:at] + new + text[at:]


def _parse(
    data: bytes, where: str, check: Callable[[str], None], loader: Any, remedy: str | None = None
) -> Any:
    try:
        text = data.decode("utf-8-sig")
        check(text)
        return yaml.load(text, Loader=loader)
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        raise damaged(where, "YAML", _problem(error), remedy) from None


def _problem(error: Exception) -> str:
    """The problem and its place, without an excerpt of the file."""
    if isinstance(error, UnicodeDecodeError):
        return "bytes that are not UTF-8 text"
    place = getattr(error, "problem_mark", None)
    if not isinstance(error, yaml.MarkedYAMLError) or place is None:
        return " ".join(str(error).split())[:200]
    return f"an error: {error.problem} in line {place.line + 1}, column {place.column + 1}"


def _require_plain(text: str) -> None:
    """Refuse what may grow when it is read."""
    depth = count = 0
    for event in yaml.parse(text, Loader=_SafeLoader):
        if isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.NodeEvent):
            count += 1
            if event.anchor is not None:
                raise _refused("anchors and aliases are not allowed", event)
            if depth == _MAX_DEPTH:
                raise _refused(f"more than {_MAX_DEPTH} levels", event)
            if count > _MAX_VALUES:
                raise _refused(f"more than {_MAX_VALUES} values", event)
            depth += isinstance(event, yaml.CollectionStartEvent)


_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""With libyaml, which the wheels of PyYAML have: it reads a rig file in a tenth of the time. It is for texts
whose depth was checked; of a deep one it overruns the stack."""


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


class PlainLoader(_SafeLoader):
    """Accepts plain decimal numbers only, and refuses duplicate names."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for i, name in enumerate(names):
            if name in names[:i]:
                shown = f" {name!r}" if _NAME.fullmatch(name) else ""  # a longer one may be a secret
                raise _refused(f"duplicate name{shown}", node)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: Any) -> int:
        if len(node.value) > _MAX_DIGITS:
            raise _refused("a number is too long", node)
        if not _WHOLE.fullmatch(node.value):  # YAML reads 010 as 8, and 1:30 as 90
            raise _refused(f"{node.value!r} is not a plain decimal number", node)
        return int(node.value)

    def construct_yaml_float(self, node: Any) -> float:
        if len(node.value) > _MAX_DIGITS or not isfinite(value := super().construct_yaml_float(node)):
            raise _refused(f"{node.value[:_MAX_DIGITS]!r} is not a finite number", node)
        if set(node.value) & set(":_"):
            raise _refused(f"{node.value!r} is not a plain decimal number", node)
        return float(value)


PlainLoader.add_constructor("tag:yaml.org,2002:int", PlainLoader.construct_yaml_int)
PlainLoader.add_constructor("tag:yaml.org,2002:float", PlainLoader.construct_yaml_float)


def _refused(problem: str, at: Any) -> yaml.YAMLError:
    return yaml.constructor.ConstructorError(None, None, problem, at.start_mark)
