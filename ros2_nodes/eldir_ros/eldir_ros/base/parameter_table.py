# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The parameters of all nodes in one table: names, descriptions, defaults, ranges. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ParameterSpec:
    """A parameter of a node."""

    name: str
    """Name; a number with a unit ends in it."""
    description: str
    default: str | float | bool | tuple[str, ...] | None = ""
    """Default value, which gives the type; None: a number that is not set."""
    low: float = 0.0
    high: float = 0.0
    """Range of a number, ends included."""
    read_only: bool = True
    """Whether it is set at the start only."""
    former_name: str = ""
    """Name in version 0.1.0, which is refused with the present one."""

    @property
    def kind(self) -> str:
        """Type of the parameter, as `ros2 param describe` names it."""
        if isinstance(self.default, bool):
            return "bool"
        if isinstance(self.default, tuple):
            return "string_array"
        return "string" if isinstance(self.default, str) else "double"


_RIG = ParameterSpec("rig", "Rig file (YAML, eldir-rig/1).")
_DESIGN = ParameterSpec("design", "Design file of the robot.")
_TAGS = ParameterSpec("tags", "File of the reference tags. Default: the tags on the topic camera/tags.")
_RELIABLE = ParameterSpec(
    "reliable_pictures", "The camera publishes reliably: no picture may be lost.", False
)
_AUTOSTART = ParameterSpec("autostart", "Configure and activate once, as soon as possible.", False)

PARAMETERS: dict[str, tuple[ParameterSpec, ...]] = {
    "relay_board": (
        _AUTOSTART,
        _RIG,
        ParameterSpec("port", "Port of the board, instead of the rig file's."),
    ),
    "actuation_sequencer": (
        _AUTOSTART,
        _RIG,
        ParameterSpec("required_nodes", "Nodes that must be active, or nothing is heated.", ()),
        ParameterSpec(
            "lead_s",
            "Time from a goal to the start of its schedule [s].",
            1.5,
            0.5,
            30.0,
            read_only=False,
            former_name="lead",
        ),
        ParameterSpec("accept_mismatch", "Reason for playing schedules that are not for this rig."),
        ParameterSpec(
            "room_c",
            "Temperature of the air around the springs, measured before the run [C]. Not set: what the rig "
            "file's thermometer shows, if there is one.",
            None,
            -20.0,
            60.0,
            read_only=False,
        ),
    ),
    "camera": (
        _AUTOSTART,
        ParameterSpec(
            "source",
            "A camera such as camera:0 or /dev/video0, a video, a folder of pictures, a log; or: virtual.",
            "virtual",
        ),
        ParameterSpec(
            "rate_hz",
            "Rate of a folder's pictures without times [1/s].",
            10.0,
            0.1,
            120.0,
            read_only=False,
            former_name="rate",
        ),
        ParameterSpec("speed", "Playback speed: 2 is twice as fast as filmed.", 1.0, 0.1, 20.0),
        ParameterSpec("wait_for", "Nodes that must be active before recorded pictures are shown.", ()),
        ParameterSpec("rig", "Rig file, for the virtual camera."),
        ParameterSpec("design", "Design file of the virtual robot."),
        ParameterSpec("lens", "Lens file of the camera, for camera_info. Default: the lens in a log."),
    ),
    "mass_tracker": (
        _AUTOSTART,
        ParameterSpec("rig", "Rig file: it names the kind of the markers."),
        ParameterSpec("design", "Design file: which masses carry markers, and where they are."),
        ParameterSpec("log", "Log of a run, instead of rig, design and tags: it contains all of them."),
        _TAGS,
        ParameterSpec("plane", "File of a calibrated plane, instead of tags."),
        ParameterSpec("marker", "Kind of the markers. Default: what the rig file names, or discs."),
        ParameterSpec(
            "overlay_period_s",
            "Time between two overlay pictures [s].",
            2.0,
            0.5,
            60.0,
            read_only=False,
            former_name="overlay_period",
        ),
        _RELIABLE,
    ),
    "mcap_recorder": (
        _AUTOSTART,
        ParameterSpec("rig", "Rig file (YAML, eldir-rig/1), attached to each log."),
        ParameterSpec("design", "Design file, attached to each log."),
        ParameterSpec(
            "schedule", "Schedule file, attached with its predictions to the log of a run that plays it."
        ),
        _TAGS,
        ParameterSpec("lens", "Lens file of the camera, attached to each log and written as camera_info."),
        ParameterSpec("plane", "File of a calibrated plane, attached to each log."),
        ParameterSpec("folder", "Folder for the logs.", "."),
        _RELIABLE,
    ),
    "range_of_motion": (
        _AUTOSTART,
        _RIG,
        _DESIGN,
        ParameterSpec("log", "Log of a run that is replayed, instead of rig, design and the topic run."),
    ),
    "robot_model": (
        _AUTOSTART,
        _DESIGN,
        ParameterSpec("log", "Log of a run that is replayed, instead of design: it contains it."),
    ),
    "virtual_bench": (
        ParameterSpec("rig", "Rig file of kind virtual."),
        _DESIGN,
        ParameterSpec("port", "Symbolic link to create to the emulated board's port."),
        ParameterSpec(
            "trace", "File for the times when contacts closed and opened, as of `eldir rig emulate`."
        ),
    ),
}
"""Parameters of each node."""
