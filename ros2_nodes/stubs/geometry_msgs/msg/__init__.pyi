# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import std_msgs.msg

class Accel:
    linear: Vector3
    angular: Vector3
    def __init__(self, *, linear: Vector3 = ..., angular: Vector3 = ...) -> None: ...

class AccelStamped:
    header: std_msgs.msg.Header
    accel: Accel
    def __init__(self, *, header: std_msgs.msg.Header = ..., accel: Accel = ...) -> None: ...

class AccelWithCovariance:
    accel: Accel
    covariance: Any
    def __init__(self, *, accel: Accel = ..., covariance: Any = ...) -> None: ...

class AccelWithCovarianceStamped:
    header: std_msgs.msg.Header
    accel: AccelWithCovariance
    def __init__(self, *, header: std_msgs.msg.Header = ..., accel: AccelWithCovariance = ...) -> None: ...

class Inertia:
    m: float
    com: Vector3
    ixx: float
    ixy: float
    ixz: float
    iyy: float
    iyz: float
    izz: float
    def __init__(self, *, m: float = ..., com: Vector3 = ..., ixx: float = ..., ixy: float = ..., ixz: float = ..., iyy: float = ..., iyz: float = ..., izz: float = ...) -> None: ...

class InertiaStamped:
    header: std_msgs.msg.Header
    inertia: Inertia
    def __init__(self, *, header: std_msgs.msg.Header = ..., inertia: Inertia = ...) -> None: ...

class Point:
    x: float
    y: float
    z: float
    def __init__(self, *, x: float = ..., y: float = ..., z: float = ...) -> None: ...

class Point32:
    x: float
    y: float
    z: float
    def __init__(self, *, x: float = ..., y: float = ..., z: float = ...) -> None: ...

class PointStamped:
    header: std_msgs.msg.Header
    point: Point
    def __init__(self, *, header: std_msgs.msg.Header = ..., point: Point = ...) -> None: ...

class Polygon:
    points: Sequence[Point32]
    def __init__(self, *, points: Sequence[Point32] = ...) -> None: ...

class PolygonInstance:
    polygon: Polygon
    id: int
    def __init__(self, *, polygon: Polygon = ..., id: int = ...) -> None: ...

class PolygonInstanceStamped:
    header: std_msgs.msg.Header
    polygon: PolygonInstance
    def __init__(self, *, header: std_msgs.msg.Header = ..., polygon: PolygonInstance = ...) -> None: ...

class PolygonStamped:
    header: std_msgs.msg.Header
    polygon: Polygon
    def __init__(self, *, header: std_msgs.msg.Header = ..., polygon: Polygon = ...) -> None: ...

class Pose:
    position: Point
    orientation: Quaternion
    def __init__(self, *, position: Point = ..., orientation: Quaternion = ...) -> None: ...

class Pose2D:
    x: float
    y: float
    theta: float
    def __init__(self, *, x: float = ..., y: float = ..., theta: float = ...) -> None: ...

class PoseArray:
    header: std_msgs.msg.Header
    poses: Sequence[Pose]
    def __init__(self, *, header: std_msgs.msg.Header = ..., poses: Sequence[Pose] = ...) -> None: ...

class PoseStamped:
    header: std_msgs.msg.Header
    pose: Pose
    def __init__(self, *, header: std_msgs.msg.Header = ..., pose: Pose = ...) -> None: ...

class PoseWithCovariance:
    pose: Pose
    covariance: Any
    def __init__(self, *, pose: Pose = ..., covariance: Any = ...) -> None: ...

class PoseWithCovarianceStamped:
    header: std_msgs.msg.Header
    pose: PoseWithCovariance
    def __init__(self, *, header: std_msgs.msg.Header = ..., pose: PoseWithCovariance = ...) -> None: ...

class Quaternion:
    x: float
    y: float
    z: float
    w: float
    def __init__(self, *, x: float = ..., y: float = ..., z: float = ..., w: float = ...) -> None: ...

class QuaternionStamped:
    header: std_msgs.msg.Header
    quaternion: Quaternion
    def __init__(self, *, header: std_msgs.msg.Header = ..., quaternion: Quaternion = ...) -> None: ...

class Transform:
    translation: Vector3
    rotation: Quaternion
    def __init__(self, *, translation: Vector3 = ..., rotation: Quaternion = ...) -> None: ...

class TransformStamped:
    header: std_msgs.msg.Header
    child_frame_id: str
    transform: Transform
    def __init__(self, *, header: std_msgs.msg.Header = ..., child_frame_id: str = ..., transform: Transform = ...) -> None: ...

class Twist:
    linear: Vector3
    angular: Vector3
    def __init__(self, *, linear: Vector3 = ..., angular: Vector3 = ...) -> None: ...

class TwistStamped:
    header: std_msgs.msg.Header
    twist: Twist
    def __init__(self, *, header: std_msgs.msg.Header = ..., twist: Twist = ...) -> None: ...

class TwistWithCovariance:
    twist: Twist
    covariance: Any
    def __init__(self, *, twist: Twist = ..., covariance: Any = ...) -> None: ...

class TwistWithCovarianceStamped:
    header: std_msgs.msg.Header
    twist: TwistWithCovariance
    def __init__(self, *, header: std_msgs.msg.Header = ..., twist: TwistWithCovariance = ...) -> None: ...

class Vector3:
    x: float
    y: float
    z: float
    def __init__(self, *, x: float = ..., y: float = ..., z: float = ...) -> None: ...

class Vector3Stamped:
    header: std_msgs.msg.Header
    vector: Vector3
    def __init__(self, *, header: std_msgs.msg.Header = ..., vector: Vector3 = ...) -> None: ...

class VelocityStamped:
    header: std_msgs.msg.Header
    body_frame_id: str
    reference_frame_id: str
    velocity: Twist
    def __init__(self, *, header: std_msgs.msg.Header = ..., body_frame_id: str = ..., reference_frame_id: str = ..., velocity: Twist = ...) -> None: ...

class Wrench:
    force: Vector3
    torque: Vector3
    def __init__(self, *, force: Vector3 = ..., torque: Vector3 = ...) -> None: ...

class WrenchStamped:
    header: std_msgs.msg.Header
    wrench: Wrench
    def __init__(self, *, header: std_msgs.msg.Header = ..., wrench: Wrench = ...) -> None: ...
