# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The real rig. Nothing is armed before a person configures and activates relay_board and the others.

ros2 launch eldir_ros real_rig.launch.py rig:=rig.yaml design:=design.json tags:=tags.json
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration

from eldir_ros.programs import launching
from eldir_ros.remote.graph_check import OBSERVERS
from launch import LaunchDescription


def _setup(context, *args, **kwargs):
    def value(name):
        return LaunchConfiguration(name).perform(context)

    external = value("camera") == "external"
    required = tuple(n for n in OBSERVERS if not (external and n == "camera"))
    values = launching.parameters(
        value("rig"),
        value("design"),
        value("logs"),
        autostart=value("autostart") == "true",
        required=required,
    )
    del values["virtual_bench"]
    if value("model") == "false":
        del values["robot_model"]
    if external:
        del values["camera"]
    else:
        values["camera"] |= {"source": value("camera"), "lens": value("lens")}
    values["mass_tracker"] |= {"tags": value("tags"), "plane": value("plane")}
    values["mcap_recorder"] |= {"tags": value("tags"), "plane": value("plane"), "lens": value("lens")}
    return launching.nodes(values, value("composed") == "true", launching.Graph.of(context))


def generate_launch_description():
    needed = (
        ("rig", "Rig file of the real rig."),
        ("design", "Design file of the robot on it."),
    )
    arguments = (
        (
            "camera",
            "external",
            "external: a driver publishes the pictures; or a name such as camera:0.",
        ),
        ("tags", "", "File with the positions of the reference tags."),
        ("plane", "", "File of a calibrated plane, instead of tags."),
        ("lens", "", "Lens file of the camera, from eldir calibrate camera."),
        ("logs", ".", "Folder for the logs."),
        ("composed", "false", "true: all nodes in one process."),
        ("autostart", "false", "true: configure and activate all nodes at once, which arms the rig."),
    )
    declared = [DeclareLaunchArgument(n, description=t) for n, t in needed]
    declared += [launching.argument(*a) for a in (*arguments, launching.MODEL, *launching.SHARED)]
    return LaunchDescription([*declared, OpaqueFunction(function=_setup)])
