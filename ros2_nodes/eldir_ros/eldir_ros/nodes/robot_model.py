# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The robot for RViz and Foxglove: its description with the shapes of its parts, moved by the marks."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

from eldir.core.files import write_bytes
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.parameters.printed import BuiltParameters
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.hubs import hub_name, hub_shapes
from eldir_hardware.vision.whole_body import estimate_body, estimate_hub_angles
from eldir_ros.base.interfaces import (
    COMPLETE,
    LATCHED,
    RELIABLE,
    declare_text,
    frame_name,
    get_file,
    new_message,
)
from eldir_ros.base.rig_node import RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import marks, robot


class RobotModelNode(RigNode):
    """Publishes robot_description, joint_states and the frames of all hubs. Only the markers are measured."""

    def __init__(self, **options: Any):
        super().__init__("robot_model", **options)
        declare_text(self, "design", "Design file of the robot.")
        self._description = self.advertise("std_msgs/msg/String", "robot_description", LATCHED)
        self._joints = self.advertise("sensor_msgs/msg/JointState", "joint_states", RELIABLE)
        self._frames = self.advertise("tf2_msgs/msg/TFMessage", "/tf", COMPLETE)
        self._springs = self.advertise("visualization_msgs/msg/MarkerArray", "robot_springs", RELIABLE)
        self.listen("visualization_msgs/msg/MarkerArray", "marks", self._on_marks, COMPLETE)
        self._ground = frame_name(self, marks.FRAME_ID)
        self._design: Design | None = None
        self._rest: FloatArray | None = None
        self._planes: tuple[float, ...] = ()
        """Distances of the planes of the springs of both faces behind that of the markers [m]."""
        self._parts: Path | None = None
        """Folder with the shapes of the parts."""

    def open(self) -> None:
        design = Design.load(get_file(self, "design"))
        spec = load_specification(None)
        middle, springs = 1e-3 * (spec.outside - spec.mass.disc_depth), 1e-3 * spec.springs_at
        self._planes = (middle - springs, middle + springs)
        shapes = hub_shapes(assemble(design.morphology, spec))
        self._parts = Path(tempfile.mkdtemp(prefix="eldir-parts-"))
        files = {hub: self._parts / f"{hub_name(hub)}.stl" for hub in shapes}
        for hub, file in files.items():
            write_bytes(file, shapes[hub])
        text = robot.urdf_text("robot", {hub: file.as_uri() for hub, file in files.items()}, middle)
        self._description.publish(new_message("std_msgs/msg/String", data=text))
        self._rest = design.morphology.positions * BuiltParameters().scale
        self._design = design

    def close(self) -> None:
        self._design = None
        if self._parts is not None:
            shutil.rmtree(self._parts, ignore_errors=True)
            self._parts = None

    def _on_marks(self, message: Any) -> None:
        if self._design is None or self._rest is None or self.state != "active" or not message.markers:
            return
        stamp, _, tracked = marks.tracks_from(message)
        body = self._design.morphology
        positions = estimate_body(self._rest, body.springs, body.active, self._design.marks, tracked)
        if positions is None:
            return
        angles = estimate_hub_angles(self._rest, body.springs, positions)
        self._joints.publish(robot.joints_of(new_message, stamp, positions, angles))
        self._frames.publish(robot.frames_of(new_message, stamp, positions, angles, self._ground))
        self._springs.publish(
            robot.springs_of(
                new_message, stamp, positions, body.springs, body.active, self._planes, self._ground
            )
        )


def main() -> None:
    """`ros2 run eldir_ros robot_model`."""
    spin([RobotModelNode])
