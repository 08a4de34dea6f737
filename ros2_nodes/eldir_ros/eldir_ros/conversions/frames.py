# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The tree of frames (REP-105): `ground` -> `camera` -> `camera_optical_frame`.

`ground` does not move. The camera's own frame has x in the direction of view, y to its left and z up; its
optical frame has z in the direction of view, x to the right and y down (REP-103).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir_hardware.camera.plane import CameraPose, to_quaternion
from eldir_ros.conversions import NewMessage, header_of

CAMERA = "camera"
_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # REP-103


def transform_of(
    new_message: NewMessage, stamp: int, parent: str, child: str, position: FloatArray, rotation: FloatArray
) -> Any:
    """geometry_msgs/TransformStamped: where a frame is in its parent, position (3,) [m], rotation (3, 3)."""
    x, y, z = (float(p) for p in position)
    a, b, c, w = to_quaternion(rotation)
    return new_message(
        "geometry_msgs/msg/TransformStamped",
        header=header_of(new_message, stamp, parent),
        child_frame_id=child,
        transform=new_message(
            "geometry_msgs/msg/Transform",
            translation=new_message("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
            rotation=new_message("geometry_msgs/msg/Quaternion", x=a, y=b, z=c, w=w),
        ),
    )


def camera_frames_of(
    new_message: NewMessage, stamp: int, pose: CameraPose, ground: str, camera: str, optical: str
) -> Any:
    """tf2_msgs/TFMessage of a camera's two frames, by the names of all three."""
    body = pose.rotation @ _FROM_OPTICAL.T
    return new_message(
        "tf2_msgs/msg/TFMessage",
        transforms=[
            transform_of(new_message, stamp, ground, camera, pose.position, body),
            transform_of(new_message, stamp, camera, optical, np.zeros(3), _FROM_OPTICAL),
        ],
    )
