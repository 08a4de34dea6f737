# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""ROS's message classes by the names that the conversions use, and the topics' qualities of service."""

from __future__ import annotations

from functools import cache, reduce
from importlib import import_module
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

RELIABLE = QoSProfile(depth=10)
"""Quality of service of publishers (REP-2003)."""
PICTURES = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Quality of service of subscribers to pictures: as sensor data (REP-2003), which matches every
driver; the queue is long enough that no picture is skipped."""
ALL_PICTURES = QoSProfile(depth=100)
"""Quality of service of pictures of which none may be lost: publisher and subscriber are this project's."""
NEWEST = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Quality of service of a subscriber that leaves out what it has no time for."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Quality of service with which a node that subscribes later still gets the last message."""
STATIC = LATCHED
"""Quality of service of /tf_static, as tf2_ros has it."""
COMPLETE = QoSProfile(depth=100)
"""Quality of service of subscribers that must not miss a message."""


@cache
def message_class(name: str) -> Any:
    """The class of a type such as sensor_msgs/msg/Image or eldir_msgs/action/RunSchedule_Result."""
    package, kind, short = name.split("/")
    return reduce(getattr, short.split("_"), import_module(f"{package}.{kind}"))


def new_message(name: str, /, **fields: Any) -> Any:
    """A message of a type, with these fields; a `eldir_ros.conversions.NewMessage`."""
    return message_class(name)(**fields)
