# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import builtin_interfaces.msg
import geometry_msgs.msg
import sensor_msgs.msg
import std_msgs.msg

class ImageMarker:
    CIRCLE: ClassVar[int]
    LINE_STRIP: ClassVar[int]
    LINE_LIST: ClassVar[int]
    POLYGON: ClassVar[int]
    POINTS: ClassVar[int]
    ADD: ClassVar[int]
    REMOVE: ClassVar[int]
    header: std_msgs.msg.Header
    ns: str
    id: int
    type: int
    action: int
    position: geometry_msgs.msg.Point
    scale: float
    outline_color: std_msgs.msg.ColorRGBA
    filled: int
    fill_color: std_msgs.msg.ColorRGBA
    lifetime: builtin_interfaces.msg.Duration
    points: Sequence[geometry_msgs.msg.Point]
    outline_colors: Sequence[std_msgs.msg.ColorRGBA]
    def __init__(self, *, header: std_msgs.msg.Header = ..., ns: str = ..., id: int = ..., type: int = ..., action: int = ..., position: geometry_msgs.msg.Point = ..., scale: float = ..., outline_color: std_msgs.msg.ColorRGBA = ..., filled: int = ..., fill_color: std_msgs.msg.ColorRGBA = ..., lifetime: builtin_interfaces.msg.Duration = ..., points: Sequence[geometry_msgs.msg.Point] = ..., outline_colors: Sequence[std_msgs.msg.ColorRGBA] = ...) -> None: ...

class InteractiveMarker:
    header: std_msgs.msg.Header
    pose: geometry_msgs.msg.Pose
    name: str
    description: str
    scale: float
    menu_entries: Sequence[MenuEntry]
    controls: Sequence[InteractiveMarkerControl]
    def __init__(self, *, header: std_msgs.msg.Header = ..., pose: geometry_msgs.msg.Pose = ..., name: str = ..., description: str = ..., scale: float = ..., menu_entries: Sequence[MenuEntry] = ..., controls: Sequence[InteractiveMarkerControl] = ...) -> None: ...

class InteractiveMarkerControl:
    INHERIT: ClassVar[int]
    FIXED: ClassVar[int]
    VIEW_FACING: ClassVar[int]
    NONE: ClassVar[int]
    MENU: ClassVar[int]
    BUTTON: ClassVar[int]
    MOVE_AXIS: ClassVar[int]
    MOVE_PLANE: ClassVar[int]
    ROTATE_AXIS: ClassVar[int]
    MOVE_ROTATE: ClassVar[int]
    MOVE_3D: ClassVar[int]
    ROTATE_3D: ClassVar[int]
    MOVE_ROTATE_3D: ClassVar[int]
    name: str
    orientation: geometry_msgs.msg.Quaternion
    orientation_mode: int
    interaction_mode: int
    always_visible: bool
    markers: Sequence[Marker]
    independent_marker_orientation: bool
    description: str
    def __init__(self, *, name: str = ..., orientation: geometry_msgs.msg.Quaternion = ..., orientation_mode: int = ..., interaction_mode: int = ..., always_visible: bool = ..., markers: Sequence[Marker] = ..., independent_marker_orientation: bool = ..., description: str = ...) -> None: ...

class InteractiveMarkerFeedback:
    KEEP_ALIVE: ClassVar[int]
    POSE_UPDATE: ClassVar[int]
    MENU_SELECT: ClassVar[int]
    BUTTON_CLICK: ClassVar[int]
    MOUSE_DOWN: ClassVar[int]
    MOUSE_UP: ClassVar[int]
    header: std_msgs.msg.Header
    client_id: str
    marker_name: str
    control_name: str
    event_type: int
    pose: geometry_msgs.msg.Pose
    menu_entry_id: int
    mouse_point: geometry_msgs.msg.Point
    mouse_point_valid: bool
    def __init__(self, *, header: std_msgs.msg.Header = ..., client_id: str = ..., marker_name: str = ..., control_name: str = ..., event_type: int = ..., pose: geometry_msgs.msg.Pose = ..., menu_entry_id: int = ..., mouse_point: geometry_msgs.msg.Point = ..., mouse_point_valid: bool = ...) -> None: ...

class InteractiveMarkerInit:
    server_id: str
    seq_num: int
    markers: Sequence[InteractiveMarker]
    def __init__(self, *, server_id: str = ..., seq_num: int = ..., markers: Sequence[InteractiveMarker] = ...) -> None: ...

class InteractiveMarkerPose:
    header: std_msgs.msg.Header
    pose: geometry_msgs.msg.Pose
    name: str
    def __init__(self, *, header: std_msgs.msg.Header = ..., pose: geometry_msgs.msg.Pose = ..., name: str = ...) -> None: ...

class InteractiveMarkerUpdate:
    KEEP_ALIVE: ClassVar[int]
    UPDATE: ClassVar[int]
    server_id: str
    seq_num: int
    type: int
    markers: Sequence[InteractiveMarker]
    poses: Sequence[InteractiveMarkerPose]
    erases: Sequence[str]
    def __init__(self, *, server_id: str = ..., seq_num: int = ..., type: int = ..., markers: Sequence[InteractiveMarker] = ..., poses: Sequence[InteractiveMarkerPose] = ..., erases: Sequence[str] = ...) -> None: ...

class Marker:
    ARROW: ClassVar[int]
    CUBE: ClassVar[int]
    SPHERE: ClassVar[int]
    CYLINDER: ClassVar[int]
    LINE_STRIP: ClassVar[int]
    LINE_LIST: ClassVar[int]
    CUBE_LIST: ClassVar[int]
    SPHERE_LIST: ClassVar[int]
    POINTS: ClassVar[int]
    TEXT_VIEW_FACING: ClassVar[int]
    MESH_RESOURCE: ClassVar[int]
    TRIANGLE_LIST: ClassVar[int]
    ARROW_STRIP: ClassVar[int]
    ADD: ClassVar[int]
    MODIFY: ClassVar[int]
    DELETE: ClassVar[int]
    DELETEALL: ClassVar[int]
    header: std_msgs.msg.Header
    ns: str
    id: int
    type: int
    action: int
    pose: geometry_msgs.msg.Pose
    scale: geometry_msgs.msg.Vector3
    color: std_msgs.msg.ColorRGBA
    lifetime: builtin_interfaces.msg.Duration
    frame_locked: bool
    points: Sequence[geometry_msgs.msg.Point]
    colors: Sequence[std_msgs.msg.ColorRGBA]
    texture_resource: str
    texture: sensor_msgs.msg.CompressedImage
    uv_coordinates: Sequence[UVCoordinate]
    text: str
    mesh_resource: str
    mesh_file: MeshFile
    mesh_use_embedded_materials: bool
    def __init__(self, *, header: std_msgs.msg.Header = ..., ns: str = ..., id: int = ..., type: int = ..., action: int = ..., pose: geometry_msgs.msg.Pose = ..., scale: geometry_msgs.msg.Vector3 = ..., color: std_msgs.msg.ColorRGBA = ..., lifetime: builtin_interfaces.msg.Duration = ..., frame_locked: bool = ..., points: Sequence[geometry_msgs.msg.Point] = ..., colors: Sequence[std_msgs.msg.ColorRGBA] = ..., texture_resource: str = ..., texture: sensor_msgs.msg.CompressedImage = ..., uv_coordinates: Sequence[UVCoordinate] = ..., text: str = ..., mesh_resource: str = ..., mesh_file: MeshFile = ..., mesh_use_embedded_materials: bool = ...) -> None: ...

class MarkerArray:
    markers: Sequence[Marker]
    def __init__(self, *, markers: Sequence[Marker] = ...) -> None: ...

class MenuEntry:
    FEEDBACK: ClassVar[int]
    ROSRUN: ClassVar[int]
    ROSLAUNCH: ClassVar[int]
    id: int
    parent_id: int
    title: str
    command: str
    command_type: int
    def __init__(self, *, id: int = ..., parent_id: int = ..., title: str = ..., command: str = ..., command_type: int = ...) -> None: ...

class MeshFile:
    filename: str
    data: Any
    def __init__(self, *, filename: str = ..., data: Any = ...) -> None: ...

class UVCoordinate:
    u: float
    v: float
    def __init__(self, *, u: float = ..., v: float = ...) -> None: ...
