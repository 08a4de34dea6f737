# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The rig without hardware: emulated board, thermal springs, robot and camera behind the same nodes.

ros2 launch eldir_ros virtual_rig.launch.py [folder:=demo] [logs:=DIR] [composed:=true] [run:=false]
"""

import tempfile
from pathlib import Path

from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration

from eldir_ros.programs import launching
from eldir_ros.remote.graph_check import OBSERVERS
from launch import LaunchDescription


def _setup(context, *args, **kwargs):
    def value(name):
        return LaunchConfiguration(name).perform(context)

    folder = Path(value("folder") or launching.example())
    port = value("port") or str(Path(tempfile.mkdtemp(prefix="eldir-")) / "board")
    values = launching.parameters(
        str(folder / "rig.yaml"),
        str(folder / "design.json"),
        value("logs"),
        port=port,
        autostart=value("autostart") == "true",
        required=OBSERVERS,
    )
    values["virtual_bench"]["trace"] = value("trace")
    if value("model") == "false":
        del values["robot_model"]
    graph = launching.Graph.of(context)
    started = launching.nodes(values, value("composed") == "true", graph)
    if value("run") == "true":
        started += launching.run(value("schedule") or str(folder / "schedule.json"), OBSERVERS, graph)
    return started


def generate_launch_description():
    arguments = (
        ("folder", "", "Folder with rig.yaml, design.json and schedule.json, as `eldir demo` writes it."),
        ("schedule", "", "Schedule file. Default: schedule.json in the folder."),
        ("logs", ".", "Folder for the logs."),
        ("port", "", "Symbolic link to create to the emulated board's port."),
        ("trace", "", "File for the times when the emulated contacts closed and opened."),
        ("composed", "false", "true: all nodes in one process."),
        ("autostart", "true", "true: configure and activate all nodes."),
        ("run", "true", "true: play the schedule, then end."),
    )
    declared = [launching.argument(*a) for a in (*arguments, launching.MODEL, *launching.SHARED)]
    return LaunchDescription([*declared, OpaqueFunction(function=_setup)])
