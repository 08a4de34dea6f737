"""Between the toolkit's values and ROS messages: pure functions, without ROS.

Messages are made through a `Make`, which the nodes fill with ROS's own classes and the tests with
those of rosbags. Stamps are whole nanoseconds.
"""

from __future__ import annotations

from typing import Any, Protocol


class Make(Protocol):
    """Makes a message of a type such as sensor_msgs/msg/Image; fields not given have their defaults."""

    def __call__(self, name: str, /, **fields: Any) -> Any: ...


def time_of(make: Make, nanoseconds: int) -> Any:
    """A stamp."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)


def nanoseconds(stamp: Any) -> int:
    """The inverse of `time_of`."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def header(make: Make, stamp: int, frame_id: str = "") -> Any:
    """Stamp [ns] and frame of a message."""
    return make("std_msgs/msg/Header", stamp=time_of(make, stamp), frame_id=frame_id)
