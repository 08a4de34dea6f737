# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Replay of a log: its pictures with their own stamps, tracked again.

ros2 launch eldir_ros replay.launch.py log:=run.mcap [speed:=2.0]
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration

from eldir_ros.programs import launching
from launch import LaunchDescription


def _setup(context, *args, **kwargs):
    def value(name):
        return LaunchConfiguration(name).perform(context)

    values = {
        "camera": {
            "source": value("log"),
            "speed": launching.number("speed", value("speed")),
            "wait_for": ["mass_tracker", *value("wait_for").split(",")],
            "autostart": True,
        },
        "mass_tracker": {"log": value("log"), "autostart": True, "reliable_pictures": True},
    }
    return launching.nodes(values, composed=False, graph=launching.Graph.of(context))


def generate_launch_description():
    declared = [
        DeclareLaunchArgument("log", description="Log of a run (.mcap)."),
        launching.argument("speed", "1.0", "Playback speed: 2 is twice as fast as filmed."),
        launching.argument("wait_for", "", "More nodes to wait for, separated by commas."),
        *(launching.argument(*a) for a in launching.SHARED),
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_setup)])
