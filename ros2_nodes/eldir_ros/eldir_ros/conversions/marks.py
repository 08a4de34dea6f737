# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Positions of the mass markers m1 to m5 in the plane of motion.

Frame `ground`: x forward, z up from the ground, y zero in the plane (REP-103); it does not move
(REP-105's `map`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir_hardware.log.messages import FRAME_ID
from eldir_hardware.markers.registration import DISC_DIAMETER, PALETTE
from eldir_ros.conversions import NewMessage, header_of, nanoseconds

_SPHERE, _ADD, _DELETE = 2, 0, 2  # of visualization_msgs/Marker


def point_of(new_message: NewMessage, stamp: int, position: FloatArray, frame: str = FRAME_ID) -> Any:
    """geometry_msgs/PointStamped of one mark (2,) [m]."""
    return new_message(
        "geometry_msgs/msg/PointStamped",
        header=header_of(new_message, stamp, frame),
        point=_point(new_message, position),
    )


def poses_of(new_message: NewMessage, stamp: int, positions: FloatArray, frame: str = FRAME_ID) -> Any:
    """geometry_msgs/PoseArray of points (K, 2) [m], such as all masses of a body."""
    upright = new_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    points = [_point(new_message, position) for position in positions]
    poses = [new_message("geometry_msgs/msg/Pose", position=p, orientation=upright) for p in points]
    header = header_of(new_message, stamp, frame)
    return new_message("geometry_msgs/msg/PoseArray", header=header, poses=poses)


def positions_from(message: Any) -> FloatArray:
    """Points (K, 2) [m] in a geometry_msgs/PoseArray."""
    return np.array([(p.position.x, p.position.z) for p in message.poses], float).reshape(-1, 2)


def markers_of(
    new_message: NewMessage,
    stamp: int,
    names: tuple[str, ...],
    positions: FloatArray,
    frame: str = FRAME_ID,
) -> Any:
    """visualization_msgs/MarkerArray of mass markers (K, 2) [m]; markers that are not tracked (NaN) are
    deleted."""
    markers = []
    size = {"x": DISC_DIAMETER, "y": DISC_DIAMETER, "z": DISC_DIAMETER}
    for index, (name, position) in enumerate(zip(names, positions, strict=True)):
        is_tracked = bool(np.isfinite(position).all())
        red, green, blue = (c / 255 for c in PALETTE[name])
        upright = new_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        where = _point(new_message, position if is_tracked else np.zeros(2))
        markers.append(
            new_message(
                "visualization_msgs/msg/Marker",
                header=header_of(new_message, stamp, frame),
                ns=name,
                id=index,
                type=_SPHERE,
                action=_ADD if is_tracked else _DELETE,
                pose=new_message("geometry_msgs/msg/Pose", position=where, orientation=upright),
                scale=new_message("geometry_msgs/msg/Vector3", **size),
                color=new_message("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
            )
        )
    return new_message("visualization_msgs/msg/MarkerArray", markers=markers)


def tracks_from(message: Any) -> tuple[int, tuple[str, ...], FloatArray]:
    """Stamp [ns], names and positions (K, 2) [m] of a visualization_msgs/MarkerArray; NaN where not
    tracked."""
    names = tuple(m.ns for m in message.markers)
    positions = [
        (m.pose.position.x, m.pose.position.z) if m.action == _ADD else (np.nan, np.nan)
        for m in message.markers
    ]
    return nanoseconds(message.markers[0].header.stamp), names, np.array(positions, float)


def _point(new_message: NewMessage, position: FloatArray) -> Any:
    return new_message("geometry_msgs/msg/Point", x=float(position[0]), y=0.0, z=float(position[1]))
