"""The common part of the launch files."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, Shutdown, TimerAction
from launch.event_handlers import OnProcessExit
from launch_ros.actions import LifecycleNode, Node

from eldir.errors import InputError
from eldir_ros.base.spinning import LAUNCHER

OBSERVERS = ("camera", "mass_tracker", "mcap_recorder", "range_of_motion")
"""Nodes that do not heat, but that every run needs."""


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
    }


def nodes(values: dict[str, dict[str, Any]], composed: bool) -> list[Any]:
    """Launch actions for the nodes in `values`: one process each, or all in one process (`composed`)."""
    if not composed:
        return [_node(name, own) for name, own in values.items()]
    # One process reads the parameters of all its nodes from one file.
    file = Path(tempfile.mkstemp(prefix="eldir-", suffix=".yaml")[1])
    file.write_text(parameter_file(values))
    arguments = [*values, "--ros-args", "--params-file", str(file)]
    return [_process("rig_process", arguments=arguments)]


def parameter_file(values: dict[str, dict[str, Any]]) -> str:
    """YAML with the parameters of several nodes. Each value is written where it is used: rcl reads no
    aliases."""
    import yaml

    class Plain(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True

    return yaml.dump({name: {"ros__parameters": own} for name, own in values.items()}, Dumper=Plain)


def argument(name: str, default: str, description: str) -> DeclareLaunchArgument:
    """A launch argument; one whose default is true or false takes nothing else."""
    choices = ["true", "false"] if default in ("true", "false") else None
    return DeclareLaunchArgument(name, default_value=default, description=description, choices=choices)


def number(name: str, text: str) -> float:
    """The value of an argument that is a number; raises `InputError`."""
    try:
        return float(text)
    except ValueError:
        raise InputError(f"the launch argument {name} is no number", found=repr(text)) from None


def run(schedule: str, required: tuple[str, ...]) -> list[Any]:
    """Launch actions that send a schedule when the nodes are active, and end the launch 3 s after the run.
    The launch then has an exit status other than 0, unless the schedule was played to its end."""
    client = _process("run_schedule", arguments=[schedule, *required])

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


def _node(name: str, own: dict[str, Any]) -> Node:
    return _process(
        name, Node if name == "virtual_bench" else LifecycleNode, name=name, namespace="", parameters=[own]
    )


def _process(executable: str, kind: Any = Node, **options: Any) -> Node:
    """A process that ends when its launcher has gone; upstream leaves it behind on SIGTERM."""
    own = {LAUNCHER: str(os.getpid())}
    return kind(package="eldir_ros", executable=executable, output="screen", additional_env=own, **options)
