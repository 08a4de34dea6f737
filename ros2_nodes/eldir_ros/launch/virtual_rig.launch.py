# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The rig without hardware: emulated board, thermal springs, robot and camera behind the same nodes.

ros2 launch eldir_ros virtual_rig.launch.py [folder:=demo] [logs:=DIR] [composed:=true] [run:=false]
"""

import atexit
import shutil
import tempfile
from pathlib import Path

from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.parameter_descriptions import ParameterValue

from eldir_ros.programs import launching
from eldir_ros.remote.graph_check import OBSERVERS
from launch import LaunchDescription


def generate_launch_description():
    folder = LaunchConfiguration("folder")
    port = str(Path(own_folder := tempfile.mkdtemp(prefix="eldir-")) / "board")
    atexit.register(shutil.rmtree, own_folder, ignore_errors=True)  # also where arguments are only shown
    arguments = launching.arguments(
        (
            "folder",
            launching.shared_file("config"),
            "Folder with rig.yaml, design.json and schedule.json, as `eldir demo` writes it.",
        ),
        (
            "schedule",
            PathJoinSubstitution([folder, "schedule.json"]),
            "Schedule file. Default: schedule.json in the folder.",
        ),
        ("logs", ".", "Folder for the logs."),
        ("port", port, "Symbolic link to create to the emulated board's port."),
        ("trace", "", "File for the times when the emulated contacts closed and opened."),
        ("autostart", "true", "true: configure and activate all nodes."),
        ("run", "true", "true: play the schedule, then end."),
        *launching.RIG,
    )
    robot = {
        "rig": ParameterValue(PathJoinSubstitution([folder, "rig.yaml"]), value_type=str),
        "design": ParameterValue(PathJoinSubstitution([folder, "design.json"]), value_type=str),
    }
    own = {"autostart": launching.flag("autostart"), "reliable_pictures": True}
    values = {
        "relay_board": {**robot, **own, "port": launching.text("port")},
        "actuation_sequencer": {**robot, **own, "required_nodes": list(OBSERVERS)},
        "camera": {**robot, **own},
        "mass_tracker": {**robot, **own},
        "mcap_recorder": {
            **robot,
            **own,
            "folder": launching.text("logs"),
            "schedule": launching.text("schedule"),
        },
        "range_of_motion": {**robot, **own},
        "virtual_bench": {**robot, "port": launching.text("port"), "trace": launching.text("trace")},
        "robot_model": {**robot, **own},
    }
    return LaunchDescription(
        [
            *arguments,
            launching.view_argument(),
            *launching.rig_nodes(values, {"robot_model": launching.with_model()}),
            *launching.viewers(),
            *launching.run(LaunchConfiguration("schedule"), OBSERVERS),
        ]
    )
