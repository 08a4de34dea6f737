# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import geometry_msgs.msg
import std_msgs.msg

class BoundingBox2D:
    center: Pose2D
    size_x: float
    size_y: float
    def __init__(self, *, center: Pose2D = ..., size_x: float = ..., size_y: float = ...) -> None: ...

class Detection2D:
    header: std_msgs.msg.Header
    results: Sequence[ObjectHypothesisWithPose]
    bbox: BoundingBox2D
    id: str
    def __init__(self, *, header: std_msgs.msg.Header = ..., results: Sequence[ObjectHypothesisWithPose] = ..., bbox: BoundingBox2D = ..., id: str = ...) -> None: ...

class Detection2DArray:
    header: std_msgs.msg.Header
    detections: Sequence[Detection2D]
    def __init__(self, *, header: std_msgs.msg.Header = ..., detections: Sequence[Detection2D] = ...) -> None: ...

class ObjectHypothesis:
    class_id: str
    score: float
    def __init__(self, *, class_id: str = ..., score: float = ...) -> None: ...

class ObjectHypothesisWithPose:
    hypothesis: ObjectHypothesis
    pose: geometry_msgs.msg.PoseWithCovariance
    def __init__(self, *, hypothesis: ObjectHypothesis = ..., pose: geometry_msgs.msg.PoseWithCovariance = ...) -> None: ...

class Point2D:
    x: float
    y: float
    def __init__(self, *, x: float = ..., y: float = ...) -> None: ...

class Pose2D:
    position: Point2D
    theta: float
    def __init__(self, *, position: Point2D = ..., theta: float = ...) -> None: ...
