"""Topics of a log: their ROS 2 types, definitions and quality of service.

Only types of ROS's own packages and of ros2_control are used, so that any ROS 2 tool shows a log without our
packages.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from eldir.core.yaml_files import dump_yaml
from eldir_hardware.camera.lens import Lens

FRAME_ID = "ground"
"""Frame of all points: x forward, z up from the ground (REP-103); y is 0 in the plane of motion."""

CAMERA_FRAME_ID = "camera_optical_frame"
"""Frame of pictures: z into the picture, x to the right, y down (REP-103)."""

METADATA = "eldir-log/1"
"""Name of the metadata record that makes an MCAP file one of our logs."""

HEAT_MODEL = "heat model"
"""Name of the status that says what the modelled temperatures follow."""
ROOM = "room_c"
"""Entry of the metadata: temperature of the air that was measured before the run [C]."""
DRY_RUN = "dry_run"
"""Entry of the metadata of a rehearsal, and name of the status that says so."""

VIRTUAL_EPOCH = 100_000_000_000
"""Start of a virtual run [ns]: a little after 1970, so that events before it have a valid time."""

IMAGE = "/camera/image_raw/compressed"
CAMERA_INFO = "/camera/camera_info"
MARKERS = "/marks"
RELAYS = "/relays"
CURRENTS = "/currents"
VOLTAGES = "/voltages"
STATUS = "/diagnostics"
VIRTUAL_RIG, MOVED_BY = "virtual rig", "moved by "
"""Name of a virtual rig's statuses. One names the physics, and begins with `MOVED_BY`; the others say what a
printed robot cannot do."""
PLAYED_TO_END = "played to the end"
"""Last message of a player whose schedule was played whole."""
CLOSED, CURRENT, VOLTAGE = "closed", "current", "voltage"
"""Interfaces in the messages of `RELAYS` (1 is closed), `CURRENTS` [A] and `VOLTAGES` [V]."""

_CONTROL_TYPES = {
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "control_msgs/msg/DynamicJointState": "std_msgs/Header header\nstring[] joint_names\n"
    "control_msgs/InterfaceValue[] interface_values\n",
}
"""Types of ros2_control, which Jazzy's own packages do not contain."""


def marker_topic(name: str) -> str:
    """Topic of the position of one marker, such as /marks/m1."""
    return f"/marks/{name}"


def spring_topic(name: str) -> str:
    """Topic of the temperature of one spring."""
    return f"/springs/{name}/temperature"


@cache
def typestore() -> Typestore:
    """Messages of ROS 2 Jazzy, and those of ros2_control that a log has."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _CONTROL_TYPES.items():
        store.register(get_types_from_msg(text, name))
    return store


@dataclass(frozen=True)
class MessageType:
    """A message type and its quality of service."""

    name: str
    latched: bool = False
    """Whether a late subscriber gets the last message."""

    @property
    def definition(self) -> str:
        """Definition of the type and of all types in it, in the schema encoding `ros2msg`."""
        return typestore().generate_msgdef(f"{self.package}/msg/{self.short}", ros_version=2)[0]

    @property
    def package(self) -> str:
        """Package of the type, such as sensor_msgs."""
        return self.name.split("/")[0]

    @property
    def short(self) -> str:
        """Name without package, such as Temperature."""
        return self.name.split("/")[-1]

    @property
    def qos(self) -> str:
        """Quality-of-service profile as YAML of rosbag2; every distribution reads policies by number."""
        endless = {"sec": 9223372036, "nsec": 854775807}
        profile = {
            "history": 1,  # keep last
            "depth": 10,
            "reliability": 1,  # reliable
            "durability": 1 if self.latched else 2,  # transient local, volatile
            "deadline": endless,
            "lifespan": endless,
            "liveliness": 1,  # automatic
            "liveliness_lease_duration": endless,
            "avoid_ros_namespace_conventions": False,
        }
        return dump_yaml([profile])

    @property
    def digest(self) -> str:
        """Hash of the type's description (REP-2016)."""
        return typestore().hash_rihs01(self.name)


MESSAGE_TYPES = {
    "image": MessageType("sensor_msgs/msg/CompressedImage"),
    "camera_info": MessageType("sensor_msgs/msg/CameraInfo", latched=True),
    "point": MessageType("geometry_msgs/msg/PointStamped"),
    "markers": MessageType("visualization_msgs/msg/MarkerArray"),
    "values": MessageType("control_msgs/msg/DynamicJointState"),
    "temperature": MessageType("sensor_msgs/msg/Temperature"),
    "status": MessageType("diagnostic_msgs/msg/DiagnosticArray", latched=True),
}


def make_message(kind: str, /, **fields: Any) -> Any:
    """A message of one of `MESSAGE_TYPES`, by its key there."""
    return typestore().types[MESSAGE_TYPES[kind].name](**fields)


def make_ros_message(name: str, /, **fields: Any) -> Any:
    """A message of any type, such as one inside another, by its full type name."""
    return typestore().types[name](**fields)


def make_header(nanoseconds: int, frame_id: str = "") -> Any:
    """A std_msgs/Header with that time [ns since 1970] and frame."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    time = make_ros_message("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    return make_ros_message("std_msgs/msg/Header", stamp=time, frame_id=frame_id)


def make_values(nanoseconds: int, names: Sequence[str], interface: str, values: Iterable[float]) -> Any:
    """A control_msgs/DynamicJointState with one number for each name."""
    pairs = [
        make_ros_message(
            "control_msgs/msg/InterfaceValue", interface_names=[interface], values=np.array([v], np.float64)
        )
        for v in values
    ]
    return make_message(
        "values", header=make_header(nanoseconds), joint_names=list(names), interface_values=pairs
    )


def read_values(message: Any) -> dict[str, float]:
    """The number of each name in a message of `RELAYS`, `CURRENTS` or `VOLTAGES`; logs of version 0.1.0 have
    sensor_msgs/JointState there."""
    if hasattr(message, "position"):
        return dict(zip(message.name, message.position.tolist(), strict=True))
    values = (float(pair.values[0]) for pair in message.interface_values)
    return dict(zip(message.joint_names, values, strict=True))


def calibration_fields(lens: Lens | None) -> dict[str, Any]:
    """Distortion model, D, K, R and P by their names in the message.

    Pictures are not rectified, so R is one and P is K. Without a lens all are zero: K[0] = 0 is how
    the message says that a camera is not calibrated.
    """
    if lens is None:
        return {
            "distortion_model": "",
            "d": np.zeros(0),
            "k": np.zeros(9),
            "r": np.zeros(9),
            "p": np.zeros(12),
        }
    return {
        "distortion_model": "plumb_bob",  # k1, k2, p1, p2, k3, in OpenCV's order as ours
        "d": lens.distortion.copy(),
        "k": lens.matrix.ravel(),
        "r": np.eye(3).ravel(),
        "p": np.column_stack([lens.matrix, np.zeros(3)]).ravel(),
    }


def camera_info_fields(lens: Lens | None, width: int, height: int) -> dict[str, Any]:
    """All fields but the header, of whole pictures of this size [px]."""
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    size = {"height": height, "width": width, "binning_x": 0, "binning_y": 0, "roi": region}
    return size | calibration_fields(lens)
