"""The markers that a test has by what it reaches: its own code, its fixtures, and what these use of `tests`.

A mark that is written by hand is forgotten when the test changes. These follow from the code: a test whose
fixture starts a guardian is `process` and `realtime`, wherever that fixture stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from types import CodeType, FunctionType, ModuleType

import pytest

SIGNS = {
    "process": (
        "subprocess",
        "multiprocessing",
        "eldir_hardware.guardian.client.Guardian",
        "tests.installed_wheel",
    ),
    "realtime": ("eldir_hardware.clock.WallClock", "eldir_hardware.guardian.client.Guardian"),
    "mujoco": ("mujoco", "eldir_hardware.virtual.mujoco_body"),
}
"""Names, with all that lies below them, that give a marker to the tests which reach them."""


def add_markers(item: pytest.Item) -> None:
    """Give a collected test the markers of all that it reaches."""
    functions = [getattr(item, "function", None)]
    definitions = getattr(getattr(item, "_fixtureinfo", None), "name2fixturedefs", {})
    functions += [definition.func for found in definitions.values() for definition in found]
    for marker in {marker for function in functions for marker in _markers_of(function)}:
        item.add_marker(marker)


@cache
def _markers_of(function: object) -> tuple[str, ...]:
    """Most items share their function and their fixtures with others."""
    reached = _reached_by(function)
    return tuple(
        marker
        for marker, signs in SIGNS.items()
        if any(name == sign or name.startswith(f"{sign}.") for name in reached for sign in signs)
    )


_KNOWN: dict[object, set[str]] = {}


def _reached_by(thing: object) -> set[str]:
    """Full names of what a function or class of `tests` uses; of anything else its own name."""
    if isinstance(thing, ModuleType):
        return {thing.__name__}
    thing = getattr(thing, "__wrapped__", thing)
    module = getattr(thing, "__module__", None) or ""
    if not isinstance(thing, FunctionType | type):
        return set()
    if not module.startswith("tests."):
        return {f"{module}.{thing.__qualname__}"}
    if thing not in _KNOWN:
        _KNOWN[thing] = {module}  # against endless turns
        parts = [thing] if isinstance(thing, FunctionType) else vars(thing).values()
        for function in list(parts):  # a record grows when it is first looked at
            if isinstance(function := getattr(function, "__func__", function), FunctionType):
                for name in _names(function.__code__):
                    _KNOWN[thing] |= _reached_by(function.__globals__.get(name))
    return _KNOWN[thing]


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _names(inner)
