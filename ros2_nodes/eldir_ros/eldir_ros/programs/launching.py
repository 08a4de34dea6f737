"""The common part of the launch files."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import RegisterEventHandler, Shutdown, TimerAction
from launch.event_handlers import OnProcessExit
from launch_ros.actions import LifecycleNode, Node

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
        "mass_tracker": {"design": design, "autostart": autostart},
        "mcap_recorder": {**both, "folder": logs},
        "range_of_motion": {**both},  # a copy: rcl reads no YAML aliases
        "virtual_bench": {"rig": rig, "design": design, "port": port},
    }


def nodes(values: dict[str, dict[str, Any]], composed: bool) -> list[Any]:
    """Launch actions for the nodes in `values`: one process each, or all in one process (`composed`)."""
    if not composed:
        return [_node(name, own) for name, own in values.items()]
    # One process reads the parameters of all its nodes from one file.
    import yaml

    file = Path(tempfile.mkstemp(prefix="eldir-", suffix=".yaml")[1])
    file.write_text(yaml.safe_dump({name: {"ros__parameters": own} for name, own in values.items()}))
    arguments = [*values, "--ros-args", "--params-file", str(file)]
    return [Node(package="eldir_ros", executable="rig_process", arguments=arguments, output="screen")]


def run(schedule: str, required: tuple[str, ...]) -> list[Any]:
    """Launch actions that send a schedule when the nodes are active, and end the launch 3 s after the run."""
    client = Node(
        package="eldir_ros", executable="run_schedule", arguments=[schedule, *required], output="screen"
    )
    ended = TimerAction(period=3.0, actions=[Shutdown(reason="the schedule has ended")])
    return [client, RegisterEventHandler(OnProcessExit(target_action=client, on_exit=[ended]))]


def _node(name: str, own: dict[str, Any]) -> Node:
    kind: Any = Node if name == "virtual_bench" else LifecycleNode
    return kind(
        package="eldir_ros", executable=name, name=name, namespace="", parameters=[own], output="screen"
    )
