# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Detected markers in the picture as vision_msgs has them, where that package is installed."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from eldir.core.records import FloatArray
from eldir_hardware.camera.plane import Plane
from eldir_hardware.markers.registration import DISC_DIAMETER
from eldir_ros.conversions import header_of

if TYPE_CHECKING:
    from vision_msgs.msg import Detection2DArray


def is_available() -> bool:
    """Whether vision_msgs is installed."""
    return find_spec("vision_msgs") is not None


def detections_of(
    stamp: int, names: tuple[str, ...], positions: FloatArray, plane: Plane, frame: str
) -> Detection2DArray:
    """The markers at `positions` (K, 2) [m] in the picture of a plane, with boxes as large as a disc appears;
    markers that are not tracked (NaN) are left out."""
    from vision_msgs.msg import (
        BoundingBox2D,
        Detection2D,
        Detection2DArray,
        ObjectHypothesis,
        ObjectHypothesisWithPose,
        Point2D,
        Pose2D,
    )

    header, found = header_of(stamp, frame), []
    for name, position in zip(names, positions, strict=True):
        if not np.isfinite(position).all():
            continue
        x, y = plane.to_pixels(position).tolist()
        size = float(DISC_DIAMETER * plane.pixels_per_metre(position))
        box = BoundingBox2D(center=Pose2D(position=Point2D(x=x, y=y), theta=0.0), size_x=size, size_y=size)
        kind = ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=name, score=1.0))
        found.append(Detection2D(header=header, results=[kind], bbox=box, id=name))
    return Detection2DArray(header=header, detections=found)
