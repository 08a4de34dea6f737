# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The tree of frames (REP-105): `ground` -> `camera` -> `camera_optical_frame`.

`ground` does not move. The camera's own frame has x in the direction of view, y to its left and z up; its
optical frame has z in the direction of view, x to the right and y down (REP-103).
"""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from tf2_msgs.msg import TFMessage

from eldir.core.records import FloatArray
from eldir_hardware.camera.plane import CameraPose, to_quaternion
from eldir_ros.conversions import header_of

CAMERA = "camera"
_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # REP-103


def transform_of(
    stamp: int, parent: str, child: str, position: FloatArray, rotation: FloatArray
) -> TransformStamped:
    """Where a frame is in its parent, position (3,) [m], rotation (3, 3)."""
    x, y, z = (float(p) for p in position)
    a, b, c, w = to_quaternion(rotation)
    return TransformStamped(
        header=header_of(stamp, parent),
        child_frame_id=child,
        transform=Transform(
            translation=Vector3(x=x, y=y, z=z),
            rotation=Quaternion(x=a, y=b, z=c, w=w),
        ),
    )


def camera_frames_of(stamp: int, pose: CameraPose, ground: str, camera: str, optical: str) -> TFMessage:
    """A camera's two frames, by the names of all three."""
    body = pose.rotation @ _FROM_OPTICAL.T
    return TFMessage(
        transforms=[
            transform_of(stamp, ground, camera, pose.position, body),
            transform_of(stamp, camera, optical, np.zeros(3), _FROM_OPTICAL),
        ],
    )
