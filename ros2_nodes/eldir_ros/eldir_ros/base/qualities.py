# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Qualities of service of the topics."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from eldir_ros.base.parameters import get_flag

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


def pictures_quality(node: Node) -> QoSProfile:
    """Quality of service of a node's subscription to pictures, by its parameter."""
    return ALL_PICTURES if get_flag(node, "reliable_pictures") else PICTURES
