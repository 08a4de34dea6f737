"""The rig file's virtual camera in front of a design's robot, for a robot that moves elsewhere."""

from __future__ import annotations

import json
from pathlib import Path

from eldir.built.robot import build
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import FieldOfView, Image
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import VirtualCameraEntry
from eldir_hardware.vision.virtual_camera import VirtualCamera


class RobotCamera:
    """Renders the robot of a design wherever its masses are."""

    def __init__(self, rig: Rig, design: Design):
        entry = rig.camera or VirtualCameraEntry(kind="virtual")
        self._springs, self._marked = design.morphology.springs, design.marks
        self._camera = VirtualCamera(
            rig.virtual.seed,
            FieldOfView.around(build(design.morphology).positions),
            size=(entry.width, entry.height),
            rate=entry.rate_hz,
            marker=rig.marker,
        )
        self.tags = json.dumps(self._camera.board.to_json())
        """The fixed tags around the robot, as the JSON of their file."""

    @property
    def lens(self) -> Lens:
        """The camera's lens, as a perfect calibration would find it."""
        return self._camera.lens

    @classmethod
    def load(cls, rig: Path, design: Path) -> RobotCamera:
        """Load a rig file and a design file. Raises `EldirError` if one is damaged."""
        return cls(Rig.load(rig), Design.load(design))

    def render(self, positions: FloatArray) -> Image:
        """BGR picture (H, W, 3) with the masses at `positions` (M, 2) [m]."""
        return self._camera.render(positions, self._springs, self._marked)
