# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Positions of the mass markers m1 to m5 in the plane of motion, and of what moves in the virtual rig.

Frame `ground`: x forward, z up from the ground, y zero in the plane (REP-103); it does not move
(REP-105's `map`).
"""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, PointStamped, Pose, PoseArray, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from eldir.core.records import FloatArray
from eldir_hardware.camera.plane import from_quaternion, to_quaternion
from eldir_hardware.camera.projection import DiscPoses
from eldir_hardware.log.messages import FRAME_ID
from eldir_hardware.markers.registration import DISC_DIAMETER, PALETTE
from eldir_ros.conversions import header_of, nanoseconds


def point_of(stamp: int, position: FloatArray, frame: str = FRAME_ID) -> PointStamped:
    """Position (2,) [m] of one marker."""
    return PointStamped(
        header=header_of(stamp, frame),
        point=_point(position),
    )


def poses_of(stamp: int, positions: FloatArray, frame: str = FRAME_ID) -> PoseArray:
    """Points (K, 2) [m], such as all masses of a body."""
    upright = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    points = [_point(position) for position in positions]
    poses = [Pose(position=p, orientation=upright) for p in points]
    header = header_of(stamp, frame)
    return PoseArray(header=header, poses=poses)


def positions_from(message: PoseArray) -> FloatArray:
    """Points (K, 2) [m] of a message."""
    return np.array([(p.position.x, p.position.z) for p in message.poses], float).reshape(-1, 2)


def discs_of(stamp: int, discs: DiscPoses, frame: str = FRAME_ID) -> PoseArray:
    """Middles of the outer sides of a robot's discs and their rotations: front and back of the first hub,
    then of the next one."""
    poses = []
    for outside, rotation in zip(
        discs.outsides.reshape(-1, 3), discs.rotations.reshape(-1, 3, 3), strict=True
    ):
        (x, y, z), (a, b, c, w) = outside.tolist(), to_quaternion(rotation)
        poses.append(Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=a, y=b, z=c, w=w)))
    return PoseArray(header=header_of(stamp, frame), poses=poses)


def discs_from(message: PoseArray) -> DiscPoses:
    """The discs of a message of `discs_of`."""
    outsides = [(p.position.x, p.position.y, p.position.z) for p in message.poses]
    turns = [p.orientation for p in message.poses]
    rotations = [from_quaternion(q.x, q.y, q.z, q.w) for q in turns]
    return DiscPoses(np.array(outsides).reshape(-1, 2, 3), np.array(rotations).reshape(-1, 2, 3, 3))


def markers_of(
    stamp: int,
    names: tuple[str, ...],
    positions: FloatArray,
    frame: str = FRAME_ID,
) -> MarkerArray:
    """Mass markers (K, 2) [m]; those that are not tracked (NaN) are deleted."""
    markers = []
    size = {"x": DISC_DIAMETER, "y": DISC_DIAMETER, "z": DISC_DIAMETER}
    for index, (name, position) in enumerate(zip(names, positions, strict=True)):
        is_tracked = bool(np.isfinite(position).all())
        red, green, blue = (c / 255 for c in PALETTE[name])
        upright = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        where = _point(position if is_tracked else np.zeros(2))
        markers.append(
            Marker(
                header=header_of(stamp, frame),
                ns=name,
                id=index,
                type=Marker.SPHERE,
                action=Marker.ADD if is_tracked else Marker.DELETE,
                pose=Pose(position=where, orientation=upright),
                scale=Vector3(**size),
                color=ColorRGBA(r=red, g=green, b=blue, a=1.0),
            )
        )
    return MarkerArray(markers=markers)


def tracks_from(message: MarkerArray) -> tuple[int, tuple[str, ...], FloatArray]:
    """Stamp [ns], names and positions (K, 2) [m] of mass markers; NaN where not tracked."""
    names = tuple(m.ns for m in message.markers)
    positions = [
        (m.pose.position.x, m.pose.position.z) if m.action == Marker.ADD else (np.nan, np.nan)
        for m in message.markers
    ]
    return nanoseconds(message.markers[0].header.stamp), names, np.array(positions, float)


def _point(position: FloatArray) -> Point:
    return Point(x=float(position[0]), y=0.0, z=float(position[1]))
