# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Conversions between the toolkit's values and ROS messages: pure functions that need no rclpy.

The messages' classes are imported; tests without ROS provide those of rosbags under the same names.
"""

from __future__ import annotations

from builtin_interfaces.msg import Duration, Time
from std_msgs.msg import Header

_SECOND = 1_000_000_000  # [ns]


def time_of(stamp: int) -> Time:
    """The message of a stamp [ns]."""
    seconds, rest = divmod(stamp, _SECOND)
    return Time(sec=seconds, nanosec=rest)


def nanoseconds(stamp: Time | Duration) -> int:
    """A stamp or a duration [ns]."""
    return int(stamp.sec) * _SECOND + int(stamp.nanosec)


def duration_of(seconds: float) -> Duration:
    """The message of a duration [s], rounded to nanoseconds; raises `OverflowError` or `ValueError` for one
    that is not finite."""
    whole, rest = divmod(round(seconds * _SECOND), _SECOND)
    return Duration(sec=whole, nanosec=rest)


def seconds_from(duration: Duration) -> float:
    """A duration [s]; that of a decimal number with up to nine places is the same number."""
    return nanoseconds(duration) / _SECOND


def header_of(stamp: int, frame_id: str = "") -> Header:
    """A header with a stamp [ns] and a frame."""
    return Header(stamp=time_of(stamp), frame_id=frame_id)
