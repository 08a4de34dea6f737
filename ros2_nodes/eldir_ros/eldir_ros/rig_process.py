"""All nodes of the rig in one process: `ros2 run eldir_ros rig_process --ros-args --params-file FILE`.

Pictures then need not leave the process's machine, and one Ctrl-C ends everything. Heat stays with the
guardian, which is a process of its own.
"""

from __future__ import annotations

import sys

import rclpy.utilities

from eldir_ros.actuation_sequencer import ActuationSequencer
from eldir_ros.camera import Camera
from eldir_ros.mass_tracker import MassTracker
from eldir_ros.mcap_recorder import McapRecorder
from eldir_ros.process import spin
from eldir_ros.range_of_motion import RangeOfMotion
from eldir_ros.relay_board import RelayBoard
from eldir_ros.virtual_bench import VirtualBench

NODES = {
    "relay_board": RelayBoard,
    "actuation_sequencer": ActuationSequencer,
    "camera": Camera,
    "mass_tracker": MassTracker,
    "mcap_recorder": McapRecorder,
    "range_of_motion": RangeOfMotion,
    "virtual_bench": VirtualBench,
}
"""The hardware last: it is put away after everything that drives it."""


def main() -> None:
    """With the names of nodes as arguments only those; otherwise all but the virtual bench."""
    named = rclpy.utilities.remove_ros_args(sys.argv)[1:]
    unknown = [n for n in named if n not in NODES]
    if unknown:
        sys.exit(f"rig_process: no such node: {', '.join(unknown)}; expected {', '.join(NODES)}")
    chosen = named or [n for n in NODES if n != "virtual_bench"]
    spin([NODES[n] for n in NODES if n in chosen])
