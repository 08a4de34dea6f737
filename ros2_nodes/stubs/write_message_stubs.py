"""Writes the type stubs of all message packages that the nodes import, beside this file.

`python ros2_nodes/stubs/write_message_stubs.py`: from the definitions of Jazzy in rosbags, those of this
repository, and those below. So the nodes are type-checked where ROS is not installed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from eldir_hardware.log.messages import typestore

HERE = Path(__file__).parent
INTERFACES = HERE.parent / "eldir_msgs"
PACKAGES = (
    "builtin_interfaces",
    "control_msgs",
    "diagnostic_msgs",
    "eldir_msgs",
    "geometry_msgs",
    "lifecycle_msgs",
    "rcl_interfaces",
    "sensor_msgs",
    "std_msgs",
    "tf2_msgs",
    "vision_msgs",
    "visualization_msgs",
)
_VISION_TYPES = {
    "Point2D": "float64 x\nfloat64 y\n",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "ObjectHypothesis": "string class_id\nfloat64 score\n",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose\n",
    "Detection2D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox2D bbox\nstring id\n",
    "Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections\n",
}
_LICENCE = """# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

"""
_PLAIN = {"string": "str", "bool": "bool", "float32": "float", "float64": "float", "byte": "bytes"}


def store() -> Typestore:
    """Jazzy's types, ours, and those of vision_msgs."""
    types = typestore()
    texts = {f"vision_msgs/msg/{name}": text for name, text in _VISION_TYPES.items()}
    texts |= {f"eldir_msgs/msg/{f.stem}": f.read_text() for f in (INTERFACES / "msg").glob("*.msg")}
    for file in (INTERFACES / "action").glob("*.action"):
        parts = file.read_text().split("---\n")
        for name, text in zip(("Goal", "Result", "Feedback"), parts, strict=True):
            texts[f"eldir_msgs/action/{file.stem}_{name}"] = text
    added: dict[str, Any] = {}
    for name, text in texts.items():
        added |= get_types_from_msg(text, name)
    types.register({name: fields for name, fields in added.items() if name not in types.types})
    return types


def stubs() -> dict[Path, str]:
    """Text of each stub file, by its path from this folder."""
    types, found = store(), {}
    for package in PACKAGES:
        found[Path(package) / "__init__.pyi"] = _LICENCE
        messages = sorted(name for name in types.types if name.startswith(f"{package}/msg/"))
        found[Path(package) / "msg" / "__init__.pyi"] = _module(types, messages, f"{package}.msg")
    actions: dict[str, list[str]] = {}
    for name in sorted(types.types):
        if name.startswith("eldir_msgs/action/"):
            actions.setdefault(name.split("/")[-1].split("_")[0], []).append(name)
    body, imports = [], set[str]()
    for action, names in actions.items():
        body.append(f"class {action}:\n")
        for name in names:
            text = _class(types, name, name.rpartition("_")[2], "eldir_msgs.action", imports)
            body.append("".join(f"    {line}\n" for line in text.splitlines()))
    found[Path("eldir_msgs/action/__init__.pyi")] = _LICENCE + _imports(imports) + "".join(body)
    return found


def _module(types: Typestore, names: list[str], module: str) -> str:
    imports: set[str] = set()
    classes = [_class(types, name, name.split("/")[-1], module, imports) for name in names]
    return _LICENCE + _imports(imports) + "\n".join(classes)


def _imports(modules: set[str]) -> str:
    head = "from collections.abc import Sequence\nfrom typing import Any, ClassVar\n\n"
    return head + "".join(f"import {module}\n" for module in sorted(modules)) + "\n" * bool(modules)


def _class(types: Typestore, name: str, short: str, module: str, imports: set[str]) -> str:
    constants, fields = types.fielddefs[name]
    lines = [f"class {short}:"]
    for constant, kind, _ in constants:
        lines.append(f"    {constant}: ClassVar[{_PLAIN.get(kind, 'int')}]")
    given = []
    for field, kind in fields:
        text, optional = _annotation(kind, module, imports)
        lines.append(f"    {field}: {text}")
        given.append(f"{field}: {optional} = ...")
    if given:
        lines.append(f"    def __init__(self, *, {', '.join(given)}) -> None: ...")
    else:
        lines.append("    def __init__(self) -> None: ...")
    return "\n".join(lines) + "\n"


def _annotation(kind: Any, module: str, imports: set[str]) -> tuple[str, str]:
    """Type of a field, and of the value given for it; numbers in arrays may come from numpy."""
    node, detail = kind
    if node == Nodetype.BASE:
        text = _PLAIN.get(detail[0], "int")
        return text, text
    if node == Nodetype.NAME:
        package, place, short = detail.split("/")
        other = f"{package}.{place}"
        text = short
        if other != module:
            imports.add(other)
            text = f"{other}.{short}"
        return text, text
    (element, _), _ = detail
    if element == Nodetype.NAME:
        text, _ = _annotation(detail[0], module, imports)
        return f"Sequence[{text}]", f"Sequence[{text}]"
    text, _ = _annotation(detail[0], module, imports)
    return ("Sequence[str]", "Sequence[str]") if text == "str" else ("Any", "Any")


if __name__ == "__main__":
    for place, text in stubs().items():
        path = HERE / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
