"""Messages for tests without ROS: rosbags' classes under the names that ROS's own ones have.

`provide_modules` makes the modules that the nodes import, such as `sensor_msgs.msg`; fields that are not
given are zero, empty or false there, as in ROS's classes.
"""

from __future__ import annotations

import runpy
import sys
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from tests.paths import ROOT

STUBS = ROOT / "ros2_nodes" / "stubs"
NOW = 1_753_000_000_123_456_789
"""A time of day of messages in these tests [ns]."""


@cache
def store() -> Typestore:
    """Jazzy's types and ours."""
    types: Typestore = runpy.run_path(str(STUBS / "write_message_stubs.py"))["store"]()
    return types


def provide_modules() -> None:
    """Make the message packages importable, unless ROS is installed."""
    if find_spec("rclpy") is not None:
        return
    actions: dict[str, Any] = {}
    for name in store().types:
        package, kind, short = name.split("/")
        if kind == "action":
            action, _, part = short.rpartition("_")
            module = _module(f"{package}.action")
            if action not in actions:
                actions[action] = type(action, (), {})
                setattr(module, action, actions[action])
            setattr(actions[action], part, message_class(name))
        elif kind == "msg":
            setattr(_module(f"{package}.msg"), short, message_class(name))


def _module(name: str) -> ModuleType:
    package = name.partition(".")[0]
    for part in (package, name):
        if part not in sys.modules:
            sys.modules[part] = ModuleType(part)
    setattr(sys.modules[package], name.partition(".")[2], sys.modules[name])
    return sys.modules[name]


@cache
def message_class(name: str) -> Any:
    """The class of a type, which can be made without its fields."""
    base = store().types[name]
    _, definitions = store().fielddefs[name]

    def initialise(self: Any, **fields: Any) -> None:
        unknown = set(fields) - {n for n, _ in definitions}
        assert not unknown, f"{name} has no {unknown}"
        values = {n: _field(kind, fields[n]) if n in fields else _default(kind) for n, kind in definitions}
        base.__init__(self, **values)

    return type(name.rpartition("/")[2], (base,), {"__init__": initialise, "TYPE": name})


def passed(message: Any) -> Any:
    """The message as it arrives: written as CDR and read back."""
    data = store().serialize_cdr(message, message.TYPE)
    return store().deserialize_cdr(data, message.TYPE)


def _field(kind: Any, value: Any) -> Any:
    node, detail = kind
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) and detail[0][0] == Nodetype.BASE:
        base = detail[0][1][0]
        if base != "string":
            data = np.frombuffer(value, np.uint8) if isinstance(value, bytes) else value
            return np.array(data, dtype=np.dtype(base))
    return value


def _default(kind: Any) -> Any:
    node, detail = kind
    if node == Nodetype.NAME:
        return message_class(detail)()
    if node == Nodetype.BASE:
        return {"string": "", "bool": False}.get(detail[0], 0.0 if detail[0].startswith("float") else 0)
    (element, name), count = detail
    if element == Nodetype.BASE and name[0] != "string":
        return np.zeros(count if node == Nodetype.ARRAY else 0, dtype=np.dtype(name[0]))
    return []
