"""ROS's own message classes, by the names that the conversions use; and the topics' qualities."""

from __future__ import annotations

from functools import cache, reduce
from importlib import import_module
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

RELIABLE = QoSProfile(depth=10)
"""What is published (REP-2003)."""
PICTURES = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""How pictures are subscribed to: as sensor data (REP-2003), so that any driver's match; none is skipped."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Who comes late gets the last message."""
COMPLETE = QoSProfile(depth=100)
"""For who must not miss one."""


@cache
def message_class(name: str) -> Any:
    """The class of a type such as sensor_msgs/msg/Image or eldir_msgs/action/RunSchedule_Result."""
    package, kind, short = name.split("/")
    return reduce(getattr, short.split("_"), import_module(f"{package}.{kind}"))


def new_message(name: str, /, **fields: Any) -> Any:
    """A message, as `eldir_ros.conversions.NewMessage` says."""
    return message_class(name)(**fields)
