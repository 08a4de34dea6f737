# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The real rig. Nothing is armed before a person configures and activates relay_board and the others.

ros2 launch eldir_ros real_rig.launch.py rig:=rig.yaml design:=design.json tags:=tags.json
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import IfElseSubstitution, LaunchConfiguration, NotEqualsSubstitution
from launch_ros.parameter_descriptions import ParameterValue

from eldir_ros.programs import launching
from eldir_ros.remote.graph_check import OBSERVERS
from launch import LaunchDescription


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument("rig", description="Rig file of the real rig."),
        DeclareLaunchArgument("design", description="Design file of the robot on it."),
        *launching.arguments(
            (
                "camera",
                "external",
                "external: a driver publishes the pictures; or a name such as camera:0.",
            ),
            ("tags", "", "File with the positions of the reference tags."),
            ("plane", "", "File of a calibrated plane, instead of tags."),
            ("lens", "", "Lens file of the camera, from eldir calibrate camera."),
            ("logs", ".", "Folder for the logs."),
            ("autostart", "false", "true: configure and activate all nodes at once, which arms the rig."),
            *launching.RIG,
        ),
        launching.view_argument(),
    ]
    own_camera = NotEqualsSubstitution(LaunchConfiguration("camera"), "external")
    observers = [n for n in OBSERVERS if n != "camera"]
    required = IfElseSubstitution(own_camera, str(list(OBSERVERS)), str(observers))
    common = {
        "rig": launching.text("rig"),
        "design": launching.text("design"),
        "autostart": launching.flag("autostart"),
        "reliable_pictures": ParameterValue(own_camera, value_type=bool),
        "tags": launching.text("tags"),
        "plane": launching.text("plane"),
        "lens": launching.text("lens"),
    }
    values = {
        "relay_board": common,
        "actuation_sequencer": {
            **common,
            "required_nodes": ParameterValue(required, value_type=list[str]),
        },
        "camera": {**common, "source": launching.text("camera")},
        "mass_tracker": common,
        "mcap_recorder": {**common, "folder": launching.text("logs")},
        "range_of_motion": common,
        "robot_model": common,
    }
    optional = {"camera": own_camera, "robot_model": launching.with_model()}
    return LaunchDescription([*arguments, *launching.rig_nodes(values, optional), *launching.viewers()])
