# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""`ros2 run eldir_ros doctor`: checks whether the graph of the rig is complete and correct.

For a rig in a namespace: `ros2 run eldir_ros doctor --ros-args -r __ns:=/left`.
"""

from __future__ import annotations

import os
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from eldir_msgs.msg import BoardState, EmergencyStop, Heartbeat
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage

from eldir.errors import EldirError
from eldir_ros.base.qualities import COMPLETE, LATCHED, PICTURES
from eldir_ros.base.spinning import ros_errors_as_eldir_errors
from eldir_ros.conversions import nanoseconds, seconds_from
from eldir_ros.remote.graph_check import GraphSnapshot, examine

_DURATION = 4.0  # [s]; diagnostics come once a second, and discovery takes its time
_TYPES = {
    "relay_board/states": "eldir_msgs/msg/BoardState",
    "relay_board/commands": "eldir_msgs/msg/HeatCommand",
    "run": "eldir_msgs/msg/Run",
    "emergency_stop": "eldir_msgs/msg/EmergencyStop",
    "alive": "eldir_msgs/msg/Heartbeat",
    "camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "marks": "visualization_msgs/msg/MarkerArray",
}


class _GraphObserver(Node):
    """Observes the graph for some seconds."""

    def __init__(self) -> None:
        super().__init__("doctor")
        self.graph = GraphSnapshot(
            int(os.environ.get("ROS_DOMAIN_ID", "0") or 0),
            os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"),
            rclpy.get_rmw_implementation_identifier(),
            self.get_namespace(),
        )
        self._states: dict[str, str] = {}
        self._faults: dict[str, str] = {}
        self.create_subscription(Heartbeat, "alive", self._on_heartbeat, COMPLETE)
        self.create_subscription(BoardState, "relay_board/states", self._on_report, COMPLETE)
        self.create_subscription(CompressedImage, "camera/image_raw/compressed", self._on_picture, PICTURES)
        self.create_subscription(EmergencyStop, "emergency_stop", self._on_stop, LATCHED)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, COMPLETE)

    def _on_heartbeat(self, message: Heartbeat) -> None:
        self._states[message.name] = message.state.label

    def _on_report(self, message: BoardState) -> None:
        now = self.get_clock().now().nanoseconds
        self.graph.skew = 1e-9 * (nanoseconds(message.header.stamp) - now) + seconds_from(message.age)

    def _on_picture(self, message: CompressedImage) -> None:
        self.graph.pictures += 1

    def _on_stop(self, message: EmergencyStop) -> None:
        self.graph.stopped = message.reason if message.stopped else ""

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if self._is_ours(status.name) and status.name.endswith(": state"):
                self._faults[status.name] = status.message if status.level == DiagnosticStatus.ERROR else ""

    def _is_ours(self, name: str) -> bool:
        """States in the common topic have the namespace in their names, if there is one."""
        space = self.get_namespace()
        return name.startswith(f"{space}/") if space != "/" else not name.startswith("/")

    def snapshot(self, seconds: float) -> GraphSnapshot:
        """The observations of so many seconds."""
        graph, space = self.graph, self.get_namespace()
        graph.duration = seconds
        graph.nodes = tuple(n for n, s in self.get_node_names_and_namespaces() if s == space)
        graph.states = self._states
        graph.commanders = tuple(
            p.node_name for p in self.get_publishers_info_by_topic("relay_board/commands")
        )
        graph.clocks = self.count_publishers("/clock")
        prefix = space.rstrip("/") + "/"
        types = {n.removeprefix(prefix): t for n, t in self.get_topic_names_and_types()}
        graph.foreign = {
            topic: f"{', '.join(types[topic])} instead of {expected}"
            for topic, expected in _TYPES.items()
            if topic in types and types[topic] != [expected]
        }
        graph.faults = tuple(
            f"{name.removeprefix(prefix)}: {text}"
            for name, text in sorted(self._faults.items())
            if text and not (graph.stopped and graph.stopped in text)
        )
        return graph


def main() -> None:
    """Exit with status 0 if nothing is wrong."""
    if rclpy.utilities.remove_ros_args(sys.argv)[1:]:
        sys.exit("usage: ros2 run eldir_ros doctor [--ros-args -r __ns:=/NAMESPACE]")
    try:
        with ros_errors_as_eldir_errors():
            rclpy.init(args=sys.argv)
            observer, executor = _GraphObserver(), SingleThreadedExecutor()
    except EldirError as error:
        sys.exit(f"doctor: {error}")
    executor.add_node(observer)
    start = time.monotonic()
    try:
        while (passed := time.monotonic() - start) < _DURATION:
            executor.spin_once(timeout_sec=0.1)
        findings = examine(observer.snapshot(passed))
    except (KeyboardInterrupt, ExternalShutdownException):
        sys.exit(130)
    for finding in findings:
        print(f"{'ok   ' if finding.ok else 'FAIL '} {finding.subject}: {finding.text}")
    rclpy.try_shutdown()
    sys.exit(0 if all(f.ok for f in findings) else 1)
