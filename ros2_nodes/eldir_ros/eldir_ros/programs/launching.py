# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The common part of the launch files."""

from __future__ import annotations

import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, Shutdown, TimerAction
from launch.event_handlers import OnProcessExit
from launch.launch_context import LaunchContext
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node

from eldir.core.yaml_files import dump_yaml
from eldir.errors import InputError
from eldir_ros.base.spinning import LAUNCHER

SHARED = (
    ("namespace", "", "Namespace of all nodes and their frames, such as left: several rigs on one graph."),
    ("use_sim_time", "false", "true: stamps follow the topic /clock; heat and its limits never do."),
)
"""Arguments of every launch file: name, default, meaning."""
MODEL = ("model", "false", "true: also robot_model, the robot for RViz and Foxglove.")
"""Argument of the launch files of a rig."""


def example() -> Path:
    """Folder with the example robot, its rig file and its schedule."""
    return Path(get_package_share_directory("eldir_ros")) / "config"


def parameters(
    rig: str, design: str, logs: str, *, port: str = "", autostart: bool, required: tuple[str, ...]
) -> dict[str, dict[str, Any]]:
    """Parameters of each node, by name; everything else is in the rig file."""
    both = {"rig": rig, "design": design, "autostart": autostart}
    return {
        "relay_board": {"rig": rig, "port": port, "autostart": autostart},
        "actuation_sequencer": {"rig": rig, "required_nodes": [*required, ""], "autostart": autostart},
        "camera": {**both},
        "mass_tracker": {"design": design, "autostart": autostart, "reliable_pictures": "camera" in required},
        "mcap_recorder": {**both, "folder": logs, "reliable_pictures": "camera" in required},
        "range_of_motion": {**both},  # a copy: rcl reads no YAML aliases
        "virtual_bench": {"rig": rig, "design": design, "port": port},
        "robot_model": {"design": design, "autostart": True},
    }


@dataclass(frozen=True)
class Graph:
    """Where the nodes of a launch file live, and whose time their stamps show."""

    namespace: str
    """Such as `left`; empty for none."""
    use_sim_time: bool

    @classmethod
    def of(cls, context: LaunchContext) -> Graph:
        """As the launch arguments `namespace` and `use_sim_time` say; raises `InputError`."""
        namespace, simulated = (LaunchConfiguration(a[0]).perform(context) for a in SHARED)
        namespace = namespace.strip("/")
        if namespace and not re.fullmatch(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", namespace):
            raise InputError(
                "invalid launch argument namespace",
                expected="letters, digits and _, such as left",
                found=repr(namespace),
            )
        return cls(namespace, simulated == "true")


def nodes(values: dict[str, dict[str, Any]], composed: bool, graph: Graph) -> list[Any]:
    """Launch actions for the nodes in `values`: one process each, or all in one process (`composed`)."""
    values = {name: own | {"use_sim_time": graph.use_sim_time} for name, own in values.items()}
    if not composed:
        return [_node(name, own, graph) for name, own in values.items()]
    # One process reads the parameters of all its nodes from one file.
    file = Path(tempfile.mkstemp(prefix="eldir-", suffix=".yaml")[1])
    file.write_text(parameter_file(values, graph.namespace))
    arguments = [*values, "--ros-args", "--params-file", str(file)]
    process = _process("rig_process", namespace=graph.namespace, arguments=arguments)
    ended = OpaqueFunction(function=lambda context: file.unlink(missing_ok=True))
    return [process, RegisterEventHandler(OnProcessExit(target_action=process, on_exit=[ended]))]


def parameter_file(values: dict[str, dict[str, Any]], namespace: str = "") -> str:
    """YAML with the parameters of several nodes. Each value is written where it is used: rcl reads no
    aliases."""
    place = f"/{namespace}/" if namespace else "/"
    return dump_yaml({place + name: {"ros__parameters": own} for name, own in values.items()})


def argument(name: str, default: str, description: str) -> DeclareLaunchArgument:
    """A launch argument; one whose default is true or false takes nothing else."""
    choices = ["true", "false"] if default in ("true", "false") else None
    return DeclareLaunchArgument(name, default_value=default, description=description, choices=choices)


def number(name: str, text: str) -> float:
    """The value of an argument that is a number; raises `InputError`."""
    try:
        return float(text)
    except ValueError:
        raise InputError(f"invalid launch argument {name}", expected="a number", found=repr(text)) from None


def run(schedule: str, required: tuple[str, ...], graph: Graph) -> list[Any]:
    """Launch actions that send a schedule when the nodes are active, and end the launch 3 s after the run.
    The launch then has an exit status other than 0, unless the schedule was played to its end."""
    client = _process("run_schedule", namespace=graph.namespace, arguments=[schedule, *required])

    def on_exit(event: Any, context: Any) -> list[Any]:
        if context.is_shutdown:
            return []
        end = (
            Shutdown(reason="the schedule has ended")
            if event.returncode == 0
            else OpaqueFunction(function=_fail)
        )
        return [TimerAction(period=3.0, actions=[end])]

    return [client, RegisterEventHandler(OnProcessExit(target_action=client, on_exit=on_exit))]


def _fail(context: Any) -> None:
    """An exception is the only way to another exit status of a launch."""
    raise RuntimeError("the schedule was not played to its end")


def _node(name: str, own: dict[str, Any], graph: Graph) -> Node:
    kind = Node if name == "virtual_bench" else LifecycleNode
    return _process(name, kind, name=name, namespace=graph.namespace, parameters=[own])


def _process(executable: str, kind: Any = Node, **options: Any) -> Node:
    """A process that ends when its launcher has gone; upstream leaves it behind on SIGTERM."""
    own = {LAUNCHER: str(os.getpid())}
    return kind(package="eldir_ros", executable=executable, output="screen", additional_env=own, **options)
