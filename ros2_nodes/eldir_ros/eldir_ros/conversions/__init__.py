"""Between the toolkit's values and ROS messages: pure functions, without ROS.

Messages are made through a `NewMessage`, which the nodes fill with ROS's own classes and the tests with
those of rosbags. Stamps are whole nanoseconds.
"""

from __future__ import annotations

from typing import Any, Protocol


class NewMessage(Protocol):
    """Makes a message of a type such as sensor_msgs/msg/Image; fields not given have their defaults."""

    def __call__(self, name: str, /, **fields: Any) -> Any: ...


def time_of(new_message: NewMessage, nanoseconds: int) -> Any:
    """A stamp."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return new_message("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)


def nanoseconds(stamp: Any) -> int:
    """The inverse of `time_of`."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def header_of(new_message: NewMessage, stamp: int, frame_id: str = "") -> Any:
    """Stamp [ns] and frame of a message."""
    return new_message("std_msgs/msg/Header", stamp=time_of(new_message, stamp), frame_id=frame_id)
