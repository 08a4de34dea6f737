# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The robot for RViz and Foxglove: its description with the shapes of its parts, moved by the markers; and
the predicted robot beside it."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from eldir.core.files import write_bytes
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.errors import EldirError
from eldir.parameters.printed import BuiltParameters
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.hubs import hub_name, hub_shapes
from eldir_hardware.vision.whole_body import estimate_body, estimate_hub_angles
from eldir_ros.base.frames import frame_name
from eldir_ros.base.logged_files import find_log, get_record
from eldir_ros.base.qualities import COMPLETE, LATCHED, RELIABLE
from eldir_ros.base.rig_node import ACTIVE, RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import marks, nanoseconds, robot


class RobotModelNode(RigNode):
    """Publishes robot_description, joint_states and the frames of all hubs. Only the markers are measured."""

    def __init__(self, **options: Any):
        super().__init__("robot_model", **options)
        self._descriptions = self.advertise(String, "robot_description", LATCHED)
        self._joints = self.advertise(JointState, "joint_states", RELIABLE)
        self._frames = self.advertise(TFMessage, "/tf", COMPLETE)
        self._springs = self.advertise(MarkerArray, "robot_springs", RELIABLE)
        self._predicted_springs = self.advertise(MarkerArray, "predicted/robot_springs", RELIABLE)
        self.listen(MarkerArray, "marks", self._on_marks, COMPLETE)
        self.listen(PoseArray, "predicted/masses", self._on_predicted, COMPLETE)
        self._ground = frame_name(self, marks.FRAME_ID)
        self._design: Design | None = None
        self._description = ""
        self._rest: FloatArray | None = None
        self._planes: tuple[float, ...] = ()
        """Distances of the planes of the springs of both faces behind that of the markers [m]."""
        self._parts: Path | None = None
        """Folder with the shapes of the parts."""

    def open(self) -> None:
        design = get_record(self, "design", find_log(self, "log"), "design.json", Design)
        spec = load_specification(None)
        middle, springs = 1e-3 * (spec.outside - spec.mass.disc_depth), 1e-3 * spec.springs_at
        self._planes = (middle - springs, middle + springs)
        shapes = hub_shapes(assemble(design.morphology, spec))
        self._parts = Path(tempfile.mkdtemp(prefix="eldir-parts-"))
        files = {hub: self._parts / f"{hub_name(hub)}.stl" for hub in shapes}
        for hub, file in files.items():
            write_bytes(file, shapes[hub])
        text = robot.urdf_text("robot", {hub: file.as_uri() for hub, file in files.items()}, middle)
        self._description = text
        self._rest = design.morphology.positions * BuiltParameters().scale
        self._design = design

    def start(self) -> None:
        self._descriptions.publish(String(data=self._description))

    def close(self) -> None:
        self._design = None
        if self._parts is not None:
            shutil.rmtree(self._parts, ignore_errors=True)
            self._parts = None

    def _on_marks(self, message: MarkerArray) -> None:
        if self._design is None or self._rest is None or self.state != ACTIVE or not message.markers:
            return
        stamp, _, tracked = marks.tracks_from(message)
        body = self._design.morphology
        positions = estimate_body(self._rest, body.springs, body.active, self._design.marks, tracked)
        if positions is None:
            return
        angles = estimate_hub_angles(self._rest, body.springs, positions)
        self._joints.publish(robot.joints_of(stamp, positions, angles))
        self._frames.publish(robot.frames_of(stamp, positions, angles, self._ground))
        self._springs.publish(
            robot.springs_of(stamp, positions, body.springs, body.active, self._planes, self._ground)
        )

    def _on_predicted(self, message: PoseArray) -> None:
        """Draw the predicted robot at the same instant as the tracked one."""
        if self._design is None or self._rest is None or self.state != ACTIVE:
            return
        stamp, positions = nanoseconds(message.header.stamp), marks.positions_from(message)
        body = self._design.morphology
        if positions.shape != self._rest.shape:
            raise EldirError(
                "the predicted robot is another one",
                expected=f"{len(self._rest)} masses, as the design has",
                found=str(len(positions)),
            )
        angles = estimate_hub_angles(self._rest, body.springs, positions)
        self._frames.publish(robot.frames_of(stamp, positions, angles, self._ground, is_predicted=True))
        self._predicted_springs.publish(
            robot.springs_of(
                stamp, positions, body.springs, body.active, self._planes, self._ground, is_predicted=True
            )
        )


def main() -> None:
    """`ros2 run eldir_ros robot_model`."""
    spin([RobotModelNode])
