"""Parameters with a description, a range, and read-only where a change would need a restart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from eldir.errors import InputError


def declare_text(node: Node, name: str, description: str, default: str = "") -> None:
    """Declare a text that is set at the start only."""
    node.declare_parameter(name, default, ParameterDescriptor(description=description, read_only=True))


def declare_texts(node: Node, name: str, description: str) -> None:
    """Declare a list of texts that is set at the start only; [''] is the empty list, as YAML files need."""
    node.declare_parameter(name, [""], ParameterDescriptor(description=description, read_only=True))


def declare_number(
    node: Node, name: str, description: str, default: float, low: float, high: float, *, fixed: bool = False
) -> None:
    """Declare a number within a range; `fixed` numbers are limits and set at the start only."""
    bounds = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    node.declare_parameter(
        name,
        default,
        ParameterDescriptor(description=description, floating_point_range=bounds, read_only=fixed),
    )


def declare_flag(node: Node, name: str, description: str, default: bool) -> None:
    """Declare a choice that is set at the start only."""
    node.declare_parameter(name, default, ParameterDescriptor(description=description, read_only=True))


def get_value(node: Node, name: str) -> Any:
    """Of a declared parameter."""
    found = node.get_parameter(name).value
    return [t for t in found if t] if isinstance(found, list) else found


def get_path(node: Node, name: str, *, needed: bool = True) -> Path | None:
    """A file that a parameter names."""
    found = node.get_parameter(name).value
    if found:
        return Path(found).expanduser()
    if needed:
        raise InputError(
            f"the parameter {name} is not set",
            expected=node.describe_parameter(name).description,
            remedy=f"--ros-args -p {name}:=FILE",
        )
    return None
