# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The common part of the launch files."""

from __future__ import annotations

import atexit
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, Shutdown, TimerAction
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.launch_context import LaunchContext
from launch.substitution import Substitution
from launch.substitutions import (
    AndSubstitution,
    EqualsSubstitution,
    IfElseSubstitution,
    LaunchConfiguration,
    NotEqualsSubstitution,
    NotSubstitution,
    OrSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from eldir.errors import InputError
from eldir_ros.base.spinning import LAUNCHER

SHARED = (
    ("namespace", "", "Namespace of all nodes and their frames, such as left: several rigs on one graph."),
    ("use_sim_time", "false", "true: stamps follow the topic /clock; heat and its limits never do."),
)
"""Arguments of every launch file: name, default, meaning."""
RIG = (
    ("composed", "false", "true: all nodes in one process."),
    ("model", "false", "true: also robot_model, the tracked and the predicted robot for viewers."),
)
"""Arguments of the launch files of a rig."""
_VIEWS = ("none", "rviz", "foxglove")
_AS_VIEWER = "setpriv --pdeathsig TERM nice -n 10"
"""At a lower priority than the nodes: on a busy computer RViz delayed the commands to the board. And ended
with its launcher, which on SIGTERM leaves behind what it started."""
_LAST_WORDS = 3.0  # after the end of a run, in which nodes write and close [s]


class Namespace(Substitution):
    """The launch argument `namespace`; raises `InputError` for one that is no name."""

    def perform(self, context: LaunchContext) -> str:
        namespace = str(LaunchConfiguration("namespace").perform(context)).strip("/")
        if namespace and not re.fullmatch(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", namespace):
            raise InputError(
                "invalid launch argument namespace",
                expected="letters, digits and _, such as left",
                found=repr(namespace),
            )
        return namespace

    def describe(self) -> str:
        """What it is, in messages of launch."""
        return "Namespace()"


class RvizConfig(Substitution):
    """The configuration of RViz; in a namespace, a copy of it with the names there."""

    def perform(self, context: LaunchContext) -> str:
        own, namespace = shared_file("config", "rig.rviz").perform(context), Namespace().perform(context)
        if not namespace:
            return own
        folder = tempfile.mkdtemp(prefix="eldir-rviz-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        copy = Path(folder) / "rig.rviz"
        copy.write_text(in_namespace(Path(own).read_text(), namespace))
        return str(copy)

    def describe(self) -> str:
        """What it is, in messages of launch."""
        return "RvizConfig()"


def in_namespace(text: str, namespace: str) -> str:
    """A configuration of RViz whose robot's frames have the prefix of a namespace.

    RViz is in that namespace, as all topics are. But its Camera looks for camera_info from the root, unless
    the topic of the pictures is absolute (getCameraInfoTopic of image_transport)."""
    text = text.replace('TF Prefix: ""', f"TF Prefix: {namespace}")
    return text.replace("Value: camera/image_raw", f"Value: /{namespace}/camera/image_raw")


def arguments(*own: tuple[str, Any, str]) -> list[Action]:
    """Launch arguments by name, default and meaning, and those of every launch file.

    One whose default is true or false takes nothing else.
    """
    declared = []
    for name, default, description in (*own, *SHARED):
        choices = ["true", "false"] if default in ("true", "false") else None
        declared.append(
            DeclareLaunchArgument(name, default_value=default, description=description, choices=choices)
        )
    return declared


def view_argument() -> DeclareLaunchArgument:
    """The argument that starts a viewer."""
    return DeclareLaunchArgument(
        "view",
        default_value="none",
        choices=list(_VIEWS),
        description="rviz: RViz with its configuration. foxglove: foxglove_bridge; open the layout "
        "config/foxglove.json of eldir_ros in Foxglove. Both with robot_model.",
    )


@cache
def text(name: str) -> ParameterValue:
    """The value of a launch argument as a text."""
    return ParameterValue(LaunchConfiguration(name), value_type=str)


@cache
def flag(name: str) -> ParameterValue:
    """The value of a launch argument that is true or false."""
    return ParameterValue(LaunchConfiguration(name), value_type=bool)


@cache
def number(name: str) -> ParameterValue:
    """The value of a launch argument that is a number."""
    return ParameterValue(LaunchConfiguration(name), value_type=float)


def shared_file(*parts: str) -> PathJoinSubstitution:
    """A file or folder of this package."""
    return PathJoinSubstitution([FindPackageShare("eldir_ros"), *parts])


def with_model() -> Substitution:
    """Whether robot_model is started."""
    return OrSubstitution(
        LaunchConfiguration("model"), NotEqualsSubstitution(LaunchConfiguration("view"), "none")
    )


def rig_nodes(
    values: Mapping[str, Mapping[str, Any]], optional: Mapping[str, Substitution] | None = None
) -> list[Action]:
    """The nodes in `values` with their parameters: one process each, or all in one if `composed` is true.

    A node in `optional` is started only where that is true. In one process a parameter has the same value
    for all nodes, so it must be the same in `values`.
    """
    wanted, composed = optional or {}, LaunchConfiguration("composed")
    separate = NotSubstitution(composed)
    alone = [
        _process(
            name,
            Node if name == "virtual_bench" else LifecycleNode,
            name=name,
            parameters=[{**own, "use_sim_time": flag("use_sim_time")}],
            condition=IfCondition(AndSubstitution(separate, wanted[name]) if name in wanted else separate),
        )
        for name, own in values.items()
    ]
    together: dict[str, Any] = {"use_sim_time": flag("use_sim_time")}
    for own in values.values():
        other = sorted(name for name, value in own.items() if together.setdefault(name, value) is not value)
        if other:  # one node's `autostart` must not become that of all
            raise ValueError(f"nodes in one process have different values of {', '.join(other)}")
    names = [IfElseSubstitution(wanted[n], n, "") if n in wanted else n for n in values]
    one = _process("rig_process", arguments=names, parameters=[together], condition=IfCondition(composed))
    return [*alone, one]


def viewers() -> list[Action]:
    """The viewer that the argument `view` names: RViz, or the bridge to Foxglove."""
    view = LaunchConfiguration("view")
    frame = IfElseSubstitution(NotEqualsSubstitution(Namespace(), ""), [Namespace(), "/ground"], "ground")
    return [
        Node(
            package="rviz2",
            executable="rviz2",
            prefix=_AS_VIEWER,
            namespace=Namespace(),
            arguments=["-d", RvizConfig(), "-f", frame],
            condition=IfCondition(EqualsSubstitution(view, "rviz")),
        ),
        Node(
            package="foxglove_bridge",
            executable="foxglove_bridge",
            prefix=_AS_VIEWER,
            parameters=[{"address": "127.0.0.1"}],
            condition=IfCondition(EqualsSubstitution(view, "foxglove")),
        ),
    ]


def run(schedule: Substitution, required: Iterable[str]) -> list[Action]:
    """Send a schedule when the nodes are active, if the argument `run` is true; end the launch after the run.

    The launch then has an exit status other than 0, unless the schedule was played to its end."""
    client = _process(
        "run_schedule", arguments=[schedule, *required], condition=IfCondition(LaunchConfiguration("run"))
    )

    def on_exit(event: Any, context: LaunchContext) -> list[Action]:
        if context.is_shutdown:
            return []
        is_played = event.returncode == 0
        end = Shutdown(reason="the schedule has ended") if is_played else OpaqueFunction(function=_fail)
        return [TimerAction(period=_LAST_WORDS, actions=[end])]

    return [client, RegisterEventHandler(OnProcessExit(target_action=client, on_exit=on_exit))]


def _fail(context: LaunchContext) -> None:
    """An exception is the only way to another exit status of a launch."""
    raise RuntimeError("the schedule was not played to its end")


def _process(executable: str, kind: Any = Node, **options: Any) -> Node:
    """A process that ends when its launcher has gone; upstream leaves it behind on SIGTERM."""
    own = {LAUNCHER: str(os.getpid())}
    return kind(
        package="eldir_ros",
        executable=executable,
        namespace=Namespace(),
        output="screen",
        additional_env=own,
        **options,
    )
