# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""All nodes of the rig in one process: `ros2 run eldir_ros rig_process --ros-args --params-file FILE`.

One Ctrl-C ends them all. The heat stays with the guardian, which is a process of its own.
"""

from __future__ import annotations

import sys

import rclpy.utilities

from eldir_ros.base.spinning import spin
from eldir_ros.nodes.actuation_sequencer import ActuationSequencerNode
from eldir_ros.nodes.camera import CameraNode
from eldir_ros.nodes.mass_tracker import MassTrackerNode
from eldir_ros.nodes.mcap_recorder import McapRecorderNode
from eldir_ros.nodes.range_of_motion import RangeOfMotionNode
from eldir_ros.nodes.relay_board import RelayBoardNode
from eldir_ros.nodes.robot_model import RobotModelNode
from eldir_ros.nodes.virtual_bench import VirtualBenchNode

NODES = {
    "actuation_sequencer": ActuationSequencerNode,
    "relay_board": RelayBoardNode,
    "camera": CameraNode,
    "mass_tracker": MassTrackerNode,
    "mcap_recorder": McapRecorderNode,
    "range_of_motion": RangeOfMotionNode,
    "robot_model": RobotModelNode,
    "virtual_bench": VirtualBenchNode,
}
"""Nodes in the order of their shutdown: each ends before those that prove to it that everything is off."""


def main() -> None:
    """Run the nodes named as arguments; without arguments, all that a run needs."""
    named = [n for n in rclpy.utilities.remove_ros_args(sys.argv)[1:] if n]
    unknown = [n for n in named if n not in NODES]
    if unknown:
        sys.exit(f"rig_process: no such node: {', '.join(unknown)}; expected {', '.join(NODES)}")
    chosen = named or [n for n in NODES if n not in ("virtual_bench", "robot_model")]
    spin([NODES[n] for n in NODES if n in chosen])
