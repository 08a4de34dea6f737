# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Replay of a log: its pictures with their own stamps, tracked again.

ros2 launch eldir_ros replay.launch.py log:=run.mcap [speed:=2.0] [view:=rviz]
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.parameter_descriptions import ParameterValue

from eldir_ros.programs import launching
from launch import LaunchDescription


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument("log", description="Log of a run (.mcap)."),
        *launching.arguments(
            ("speed", "1.0", "Playback speed: 2 is twice as fast as filmed."),
            ("wait_for", "", "More nodes to wait for, separated by commas."),
            *launching.RIG,
        ),
        launching.view_argument(),
    ]
    waiting = ParameterValue(
        ["[mass_tracker, range_of_motion, ", LaunchConfiguration("wait_for"), "]"], value_type=list[str]
    )
    values = {
        "camera": {
            "source": launching.text("log"),
            "speed": launching.number("speed"),
            "wait_for": waiting,
            "autostart": True,
        },
        "mass_tracker": {"log": launching.text("log"), "autostart": True, "reliable_pictures": True},
        "range_of_motion": {"log": launching.text("log"), "autostart": True},
        "robot_model": {"log": launching.text("log"), "autostart": True},
    }
    nodes = launching.rig_nodes(values, {"robot_model": launching.with_model()})
    return LaunchDescription([*arguments, *nodes, *launching.viewers()])
