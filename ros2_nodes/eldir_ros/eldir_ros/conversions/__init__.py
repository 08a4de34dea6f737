# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Conversions between the toolkit's values and ROS messages: pure functions that need no ROS.

They take a `NewMessage`: nodes give one for ROS's classes, tests one for rosbags' classes.
"""

from __future__ import annotations

from typing import Any, Protocol


class NewMessage(Protocol):
    """Creates a message of a type such as sensor_msgs/msg/Image; other fields keep their defaults."""

    def __call__(self, name: str, /, **fields: Any) -> Any: ...


def time_of(new_message: NewMessage, stamp: int) -> Any:
    """builtin_interfaces/Time of a stamp [ns]."""
    seconds, rest = divmod(stamp, 1_000_000_000)
    return new_message("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)


def nanoseconds(stamp: Any) -> int:
    """Stamp [ns] of a builtin_interfaces/Time."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def header_of(new_message: NewMessage, stamp: int, frame_id: str = "") -> Any:
    """std_msgs/Header with a stamp [ns] and a frame."""
    return new_message("std_msgs/msg/Header", stamp=time_of(new_message, stamp), frame_id=frame_id)
