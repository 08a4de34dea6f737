"""What the launch files have in common."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import RegisterEventHandler, Shutdown, TimerAction
from launch.event_handlers import OnProcessExit
from launch_ros.actions import LifecycleNode, Node

OBSERVERS = ("camera", "mass_tracker", "mcap_recorder", "range_of_motion")
"""Nodes that heat nothing, without which a run is of no use."""


def example() -> Path:
    """The robot, its rig file and its schedule that come with the package."""
    return Path(get_package_share_directory("eldir_ros")) / "config"


def parameters(
    rig: str, design: str, logs: str, *, port: str = "", autostart: bool, required: tuple[str, ...]
) -> dict[str, dict[str, Any]]:
    """Of each node; the rig file says everything else."""
    both = {"rig": rig, "design": design, "autostart": autostart}
    return {
        "relay_board": {"rig": rig, "port": port, "autostart": autostart},
        "actuation_sequencer": {"rig": rig, "required_nodes": [*required, ""], "autostart": autostart},
        "camera": both,
        "mass_tracker": {"design": design, "autostart": autostart},
        "mcap_recorder": {**both, "folder": logs},
        "range_of_motion": both,
        "virtual_bench": {"rig": rig, "design": design, "port": port},
    }


def nodes(values: dict[str, dict[str, Any]], composed: bool) -> list[Any]:
    """Each node in a process of its own, or all in one."""
    if not composed:
        return [_node(name, own) for name, own in values.items()]
    # One process reads the parameters of all its nodes from one file.
    import yaml

    file = Path(tempfile.mkstemp(prefix="eldir-", suffix=".yaml")[1])
    file.write_text(yaml.safe_dump({name: {"ros__parameters": own} for name, own in values.items()}))
    arguments = [*values, "--ros-args", "--params-file", str(file)]
    return [Node(package="eldir_ros", executable="rig_process", arguments=arguments, output="screen")]


def run(schedule: str, needed: tuple[str, ...]) -> list[Any]:
    """Send a schedule when the nodes are active; a moment after it has been played, everything ends."""
    client = Node(
        package="eldir_ros", executable="run_schedule", arguments=[schedule, *needed], output="screen"
    )
    ended = TimerAction(period=3.0, actions=[Shutdown(reason="the schedule has ended")])
    return [client, RegisterEventHandler(OnProcessExit(target_action=client, on_exit=[ended]))]


def _node(name: str, own: dict[str, Any]) -> Node:
    kind: Any = Node if name == "virtual_bench" else LifecycleNode
    return kind(
        package="eldir_ros", executable=name, name=name, namespace="", parameters=[own], output="screen"
    )
