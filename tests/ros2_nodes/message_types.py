"""Messages for tests without ROS: rosbags' classes, with the defaults that ROS's own ones have."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

INTERFACES = Path(__file__).parents[2] / "ros2_nodes" / "eldir_msgs"


@cache
def store() -> Typestore:
    """Jazzy's types and ours."""
    types = get_typestore(Stores.ROS2_JAZZY)
    texts = {f"eldir_msgs/msg/{f.stem}": f.read_text() for f in (INTERFACES / "msg").glob("*.msg")}
    for file in (INTERFACES / "action").glob("*.action"):
        parts = file.read_text().split("---\n")
        for name, text in zip(("Goal", "Result", "Feedback"), parts, strict=True):
            texts[f"eldir_msgs/action/{file.stem}_{name}"] = text
    added: dict[str, Any] = {}
    for name, text in texts.items():
        added |= get_types_from_msg(text, name)
    types.register(added)
    return types


def new_message(name: str, /, **fields: Any) -> Any:
    """A message of a type; fields not given are zero, empty or false."""
    _, definitions = store().fielddefs[name]
    unknown = set(fields) - {n for n, _ in definitions}
    assert not unknown, f"{name} has no {unknown}"
    values = {n: _field(kind, fields[n]) if n in fields else _default(kind) for n, kind in definitions}
    return store().types[name](**values)


def passed(message: Any, name: str) -> Any:
    """The message as it arrives: written as CDR and read back."""
    data = store().serialize_cdr(message, name)
    return store().deserialize_cdr(data, name)


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
        return new_message(detail)
    if node == Nodetype.BASE:
        return {"string": "", "bool": False}.get(detail[0], 0.0 if detail[0].startswith("float") else 0)
    (element, name), count = detail
    if element == Nodetype.BASE and name[0] != "string":
        return np.zeros(count if node == Nodetype.ARRAY else 0, dtype=np.dtype(name[0]))
    return []
