# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""`ros2 run eldir_ros doctor`: is the graph of the rig complete, and is it the right one.

For a rig in a namespace: `ros2 run eldir_ros doctor --ros-args -r __ns:=/left`.
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from eldir.errors import EldirError
from eldir_ros.base.joining import joining
from eldir_ros.base.message_types import COMPLETE, LATCHED, PICTURES, message_class
from eldir_ros.conversions import nanoseconds
from eldir_ros.remote.graph_check import Seen, examine

_WATCHED = 4.0  # so long [s]; diagnostics come once a second, and discovery takes its time
_TYPES = {
    "relay_board/states": "eldir_msgs/msg/BoardState",
    "relay_board/commands": "eldir_msgs/msg/HeatCommand",
    "run": "eldir_msgs/msg/Run",
    "emergency_stop": "eldir_msgs/msg/EmergencyStop",
    "alive": "diagnostic_msgs/msg/KeyValue",
    "camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "marks": "visualization_msgs/msg/MarkerArray",
}
_ERROR = 2  # level of diagnostic_msgs


class _Watch(Node):
    """Listens for some seconds."""

    def __init__(self) -> None:
        super().__init__("doctor")
        self.seen = Seen(
            int(os.environ.get("ROS_DOMAIN_ID", "0") or 0),
            os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"),
            rclpy.get_rmw_implementation_identifier(),
            self.get_namespace(),
        )
        self._states: dict[str, str] = {}
        self._faults: dict[str, str] = {}
        for topic, name, heard, quality in (
            ("alive", "diagnostic_msgs/msg/KeyValue", self._on_beat, COMPLETE),
            ("relay_board/states", "eldir_msgs/msg/BoardState", self._on_report, COMPLETE),
            ("camera/image_raw/compressed", "sensor_msgs/msg/CompressedImage", self._on_picture, PICTURES),
            ("emergency_stop", "eldir_msgs/msg/EmergencyStop", self._on_stop, LATCHED),
            ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", self._on_diagnostics, COMPLETE),
        ):
            self.create_subscription(message_class(name), topic, heard, quality)

    def _on_beat(self, message: Any) -> None:
        self._states[message.key] = message.value

    def _on_report(self, message: Any) -> None:
        now = self.get_clock().now().nanoseconds
        self.seen.skew = 1e-9 * (nanoseconds(message.header.stamp) - now) + message.age

    def _on_picture(self, message: Any) -> None:
        self.seen.pictures += 1

    def _on_stop(self, message: Any) -> None:
        self.seen.stopped = message.reason if message.stopped else ""

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            if self._is_ours(status.name) and status.name.endswith(": state"):
                self._faults[status.name] = status.message if status.level[0] == _ERROR else ""

    def _is_ours(self, name: str) -> bool:
        """States in the common topic have the namespace in their names, if there is one."""
        space = self.get_namespace()
        return name.startswith(f"{space}/") if space != "/" else not name.startswith("/")

    def conclude(self, seconds: float) -> Seen:
        """What was seen in so many seconds."""
        seen, space = self.seen, self.get_namespace()
        seen.watched = seconds
        seen.nodes = tuple(n for n, s in self.get_node_names_and_namespaces() if s == space)
        seen.states = self._states
        seen.commanders = tuple(
            p.node_name for p in self.get_publishers_info_by_topic("relay_board/commands")
        )
        seen.clocks = self.count_publishers("/clock")
        prefix = space.rstrip("/") + "/"
        types = {n.removeprefix(prefix): t for n, t in self.get_topic_names_and_types()}
        seen.foreign = {
            topic: f"{', '.join(types[topic])} instead of {wanted}"
            for topic, wanted in _TYPES.items()
            if topic in types and types[topic] != [wanted]
        }
        seen.faults = tuple(
            f"{name.removeprefix(prefix)}: {text}"
            for name, text in sorted(self._faults.items())
            if text and not (seen.stopped and seen.stopped in text)
        )
        return seen


def main() -> None:
    """Exit with status 0 if nothing is wrong."""
    if rclpy.utilities.remove_ros_args(sys.argv)[1:]:
        sys.exit("usage: ros2 run eldir_ros doctor [--ros-args -r __ns:=/NAMESPACE]")
    try:
        with joining():
            rclpy.init(args=sys.argv)
            watch, executor = _Watch(), SingleThreadedExecutor()
    except EldirError as error:
        sys.exit(f"doctor: {error}")
    executor.add_node(watch)
    begun = time.monotonic()
    try:
        while (passed := time.monotonic() - begun) < _WATCHED:
            executor.spin_once(timeout_sec=0.1)
        found = examine(watch.conclude(passed))
    except (KeyboardInterrupt, ExternalShutdownException):
        sys.exit(130)
    for finding in found:
        print(f"{'ok   ' if finding.ok else 'WRONG'} {finding.subject}: {finding.text}")
    rclpy.try_shutdown()
    sys.exit(0 if all(f.ok for f in found) else 1)
