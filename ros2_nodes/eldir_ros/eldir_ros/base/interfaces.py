# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Interfaces of nodes: message classes, qualities of service, and parameters.

A parameter has a description, a range, and is read-only where a change would need a restart.
"""

from __future__ import annotations

from functools import cache, reduce
from importlib import import_module
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from eldir.errors import InputError

RELIABLE = QoSProfile(depth=10)
"""Quality of service of publishers (REP-2003)."""
PICTURES = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Quality of service of subscribers to pictures: as sensor data (REP-2003), which matches every
driver; the queue is long enough that no picture is skipped."""
ALL_PICTURES = QoSProfile(depth=100)
"""Quality of service of pictures of which none may be lost: publisher and subscriber are this project's."""
NEWEST = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Quality of service of a subscriber that leaves out what it has no time for."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Quality of service with which a node that subscribes later still gets the last message."""
STATIC = LATCHED
"""Quality of service of /tf_static, as tf2_ros has it."""
COMPLETE = QoSProfile(depth=100)
"""Quality of service of subscribers that must not miss a message."""


@cache
def message_class(name: str) -> Any:
    """The class of a type such as sensor_msgs/msg/Image or eldir_msgs/action/RunSchedule_Result."""
    package, kind, short = name.split("/")
    return reduce(getattr, short.split("_"), import_module(f"{package}.{kind}"))


def new_message(name: str, /, **fields: Any) -> Any:
    """A message of a type, with these fields; a `eldir_ros.conversions.NewMessage`."""
    return message_class(name)(**fields)


def declare_text(node: Node, name: str, description: str, default: str = "") -> None:
    """Declare a text that is set at the start only."""
    node.declare_parameter(name, default, ParameterDescriptor(description=description, read_only=True))


def declare_texts(node: Node, name: str, description: str) -> None:
    """Declare a list of texts that is set at the start only; [''] is the empty list, as YAML files need."""
    node.declare_parameter(name, [""], ParameterDescriptor(description=description, read_only=True))


def declare_number(
    node: Node,
    name: str,
    description: str,
    default: float,
    low: float,
    high: float,
    *,
    read_only: bool = False,
) -> None:
    """Declare a number from `low` to `high`; a `read_only` one is set at the start only.

    At the start 2 is accepted for 2.0. Raises `InputError` for other values.
    """
    value = node.declare_parameter(name, default, ParameterDescriptor(dynamic_typing=True)).value
    node.undeclare_parameter(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError(
            f"the parameter {name} cannot be used",
            expected=f"a number from {low:g} to {high:g}",
            found=repr(value),
            remedy=f"--ros-args -p {name}:={default:g}",
        )
    bounds = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    node.declare_parameter(
        name,
        float(value),
        ParameterDescriptor(description=description, floating_point_range=bounds, read_only=read_only),
        ignore_override=True,
    )


def declare_optional_number(node: Node, name: str, description: str, low: float, high: float) -> None:
    """Declare a number from `low` to `high` that is not set by default, and may be set at any time.

    Only then it has a type; so who reads it must refuse other ones.
    """
    bounds = [FloatingPointRange(from_value=low, to_value=high)]
    descriptor = ParameterDescriptor(
        description=description, floating_point_range=bounds, dynamic_typing=True
    )
    node.declare_parameter(name, None, descriptor)


def declare_flag(node: Node, name: str, description: str) -> None:
    """Declare a flag that is set at the start only; false by default."""
    node.declare_parameter(name, False, ParameterDescriptor(description=description, read_only=True))


def declare_pictures(node: Node) -> QoSProfile:
    """Declare the parameter for the subscription to pictures; return its quality of service."""
    declare_flag(node, "reliable_pictures", "The camera publishes reliably: no picture may be lost.")
    return ALL_PICTURES if get_value(node, "reliable_pictures") else PICTURES


def frame_name(node: Node, name: str) -> str:
    """Name of one of our frames on the graph: a rig's namespace is its prefix, such as left/ground."""
    return f"{node.get_namespace()}/{name}".lstrip("/")


def get_value(node: Node, name: str) -> Any:
    """The value of a declared parameter; of a list of texts those that are not empty."""
    value = node.get_parameter(name).value
    return [t for t in value if t] if isinstance(value, list) else value


def get_optional_value(node: Node, name: str) -> Any:
    """The value of a parameter; None where it is not set, or was deleted."""
    return node.get_parameter_or(name).value


def find_file(node: Node, name: str) -> Path | None:
    """The path in a parameter; None where it is not set."""
    value = node.get_parameter(name).value
    return Path(value).expanduser() if value else None


def get_file(node: Node, name: str) -> Path:
    """The path in a parameter; raises `InputError` where it is not set."""
    path = find_file(node, name)
    if path is None:
        raise InputError(
            f"the parameter {name} is not set",
            expected=node.describe_parameter(name).description,
            remedy=f"--ros-args -p {name}:=FILE",
        )
    return path
