"""Topics of a log: their ROS 2 types, definitions and quality of service.

Only standard types are used, so that any ROS 2 tool shows a log without our packages.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

FRAME_ID = "ground"
"""Frame of all points: x forward, z up from the ground (REP-103); y is 0 in the plane of motion."""

METADATA = "eldir-log/1"
"""Name of the metadata record that makes an MCAP file one of our logs."""

IMAGE = "/camera/image_raw/compressed"
CAMERA_INFO = "/camera/camera_info"
MARKERS = "/marks"
RELAYS = "/relays"
STATUS = "/diagnostics"


def mark_topic(name: str) -> str:
    """Where the position of one mark is published, such as /marks/m1."""
    return f"/marks/{name}"


def spring_topic(name: str) -> str:
    """Where the temperature of one spring is published."""
    return f"/springs/{name}/temperature"


@cache
def types() -> Typestore:
    """Messages of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


@dataclass(frozen=True)
class Kind:
    """A message type and how it is offered."""

    name: str
    latched: bool = False
    """Whether who comes late gets the last message."""

    @property
    def definition(self) -> str:
        """Text of the type and of all it contains, as schemas of encoding `ros2msg` are."""
        return types().generate_msgdef(f"{self.package}/msg/{self.short}", ros_version=2)[0]

    @property
    def package(self) -> str:
        """Such as sensor_msgs."""
        return self.name.split("/")[0]

    @property
    def short(self) -> str:
        """Such as Temperature."""
        return self.name.split("/")[-1]

    @property
    def qos(self) -> str:
        """Profile offered, in the YAML of rosbag2."""
        endless = {"sec": 2147483647, "nsec": 4294967295}
        durability = "transient_local" if self.latched else "volatile"
        lines = ["history: keep_last", "depth: 10", "reliability: reliable", f"durability: {durability}"]
        for limit in ("deadline", "lifespan"):
            lines += [f"{limit}:", *(f"  {k}: {v}" for k, v in endless.items())]
        lines += ["liveliness: automatic", "liveliness_lease_duration:"]
        lines += [f"  {k}: {v}" for k, v in endless.items()]
        lines.append("avoid_ros_namespace_conventions: false")
        return "\n".join(("- " if i == 0 else "  ") + line for i, line in enumerate(lines)) + "\n"


KINDS = {
    "image": Kind("sensor_msgs/msg/CompressedImage"),
    "camera_info": Kind("sensor_msgs/msg/CameraInfo", latched=True),
    "point": Kind("geometry_msgs/msg/PointStamped"),
    "markers": Kind("visualization_msgs/msg/MarkerArray"),
    "relays": Kind("sensor_msgs/msg/JointState"),
    "temperature": Kind("sensor_msgs/msg/Temperature"),
    "status": Kind("diagnostic_msgs/msg/DiagnosticArray", latched=True),
}


def build(kind: str, /, **fields: Any) -> Any:
    """A message of one of our kinds."""
    return types().types[KINDS[kind].name](**fields)


def part(name: str, /, **fields: Any) -> Any:
    """A message inside another, by its full type name."""
    return types().types[name](**fields)


def header(nanoseconds: int, frame_id: str = "") -> Any:
    """Stamp of a message."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    time = part("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    return part("std_msgs/msg/Header", stamp=time, frame_id=frame_id)
