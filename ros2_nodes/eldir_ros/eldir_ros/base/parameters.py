# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Declares the parameters of a node as the table has them, and reads their values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from eldir.errors import InputError
from eldir_ros.base.parameter_table import PARAMETERS, ParameterSpec


def declare_parameters(node: Node, name: str) -> None:
    """Declare the parameters of the node with that name in the table.

    Raises `InputError` for a number out of its range, and for a name of version 0.1.0.
    """
    for spec in PARAMETERS[name]:
        _refuse_former_name(node, spec)
        descriptor = ParameterDescriptor(description=spec.description, read_only=spec.read_only)
        if spec.kind == "double":
            _declare_number(node, spec, descriptor)
        else:
            # [''] is the empty list, as YAML files need.
            default = list(spec.default) or [""] if isinstance(spec.default, tuple) else spec.default
            node.declare_parameter(spec.name, default, descriptor)


def _refuse_former_name(node: Node, spec: ParameterSpec) -> None:
    """ROS ignores values for names that are not declared; one that was meant must not be ignored."""
    if not spec.former_name:
        return
    given = node.declare_parameter(spec.former_name, None, ParameterDescriptor(dynamic_typing=True)).value
    node.undeclare_parameter(spec.former_name)
    if given is not None:
        raise InputError(
            f"the parameter {spec.former_name} has another name since version 0.1.0",
            expected=spec.name,
            found=f"{spec.former_name}: {given!r}",
            remedy=f"--ros-args -p {spec.name}:={given}",
        )


def _declare_number(node: Node, spec: ParameterSpec, descriptor: ParameterDescriptor) -> None:
    """Declare a number; at the start 2 is accepted for 2.0.

    One without default has a type only when it is set, so who reads it must refuse other ones.
    """
    descriptor.floating_point_range = [FloatingPointRange(from_value=spec.low, to_value=spec.high)]
    if spec.default is None:
        descriptor.dynamic_typing = True
        node.declare_parameter(spec.name, None, descriptor)
        return
    value = node.declare_parameter(spec.name, spec.default, ParameterDescriptor(dynamic_typing=True)).value
    node.undeclare_parameter(spec.name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not spec.low <= value <= spec.high:
        raise InputError(
            f"the parameter {spec.name} cannot be used",
            expected=f"a number from {spec.low:g} to {spec.high:g}",
            found=repr(value),
            remedy=f"--ros-args -p {spec.name}:={spec.default:g}",
        )
    node.declare_parameter(spec.name, float(value), descriptor, ignore_override=True)


def get_text(node: Node, name: str) -> str:
    """The value of a text; empty where it is not set."""
    return str(node.get_parameter(name).value)


def get_texts(node: Node, name: str) -> tuple[str, ...]:
    """The texts of a list that are not empty."""
    return tuple(t for t in node.get_parameter(name).value if t)


def get_number(node: Node, name: str) -> float:
    """The value of a number that has a default."""
    return float(node.get_parameter(name).value)


def get_flag(node: Node, name: str) -> bool:
    """The value of a flag."""
    return bool(node.get_parameter(name).value)


def get_optional_value(node: Node, name: str) -> Any:
    """The value of a parameter; None where it is not set, or was deleted."""
    return node.get_parameter_or(name).value


def find_file(node: Node, name: str) -> Path | None:
    """The path in a parameter; None where it is not set."""
    value = get_text(node, name)
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
