"""Filming a run: the virtual camera, and the calibration files that are kept with the log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from eldir.core.records import FileRecord, IntArray
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Plane, TagBoard
from eldir_hardware.camera.validity import require_valid
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import LiveCameraEntry, VirtualCameraEntry
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.rig import BodyFrame, DrivenBody

if TYPE_CHECKING:
    from eldir_hardware.vision.virtual_camera import VirtualCamera

_LEAST_ROOM = 1.0
"""Least distance ahead and behind that the camera sees [body lengths]."""
_SPARE = 0.3  # [body lengths]
STALL = 1.0
"""A longer time without a frame is reported [s]."""


class FilmLog(Protocol):
    """A log that takes files, pictures, and reports of missing pictures."""

    def attach(self, name: str, file: FileRecord | bytes) -> None: ...

    def on_frame(self, t: float, bgr: NDArray[np.uint8]) -> None: ...

    def on_stall(self, t: float, seconds: float) -> None: ...


@dataclass(frozen=True)
class CameraFiles:
    """The calibration files of a camera, as far as they exist."""

    lens: Lens | None = None
    plane: Plane | None = None
    tags: TagBoard | None = None

    @classmethod
    def of(cls, rig: Rig, rig_path: Path) -> CameraFiles:
        """Load the files that a rig file names. Raises `InputError` if one expired or does not fit."""
        if rig.camera is None:
            return cls()
        now, folder = datetime.now(UTC), rig_path.parent
        lens = None if rig.camera.lens is None else Lens.load(folder / rig.camera.lens)
        plane = None if rig.camera.plane is None else Plane.load(folder / rig.camera.plane)
        if lens is not None:
            require_valid(lens.provenance, now, str(rig.camera.lens))
            lens.require_size(rig.camera.width, rig.camera.height)
        if plane is not None:
            require_valid(plane.provenance, now, str(rig.camera.plane))
            plane.require_size(rig.camera.width, rig.camera.height)
        tags = rig.camera.tags if isinstance(rig.camera, LiveCameraEntry) else None
        return cls(lens, plane, None if tags is None else TagBoard.load(folder / tags))

    def attach_to(self, log: FilmLog) -> None:
        """Attach plane and tags; the recorder attaches the lens itself."""
        for name, file in (("plane.json", self.plane), ("tags.json", self.tags)):
            if file is not None:
                log.attach(name, file)


def virtual_camera(
    rig: Rig, entry: VirtualCameraEntry, robot: DrivenBody, schedule: ActuationSchedule
) -> VirtualCamera:
    """The rig's virtual camera, far enough away to see all places that the robot should reach."""
    from eldir_hardware.camera.plane import FieldOfView
    from eldir_hardware.vision.virtual_camera import VirtualCamera

    return VirtualCamera(
        rig.virtual.seed,
        FieldOfView.around(robot.positions, *room(schedule)),
        size=(entry.width, entry.height),
        rate=entry.rate_hz,
        marker=rig.marker,
    )


def film(
    camera: VirtualCamera, marked: IntArray, log: FilmLog, see: Callable[[BodyFrame], None]
) -> Callable[[BodyFrame], None]:
    """A function that renders the camera's picture of a body frame and records it."""
    log.attach("tags.json", camera.board)
    previous = 0.0

    def shoot(frame: BodyFrame) -> None:
        nonlocal previous
        if frame.time_s - previous > STALL:
            log.on_stall(frame.time_s, frame.time_s - previous)
        previous = frame.time_s
        see(frame)
        log.on_frame(frame.time_s, camera.render(frame.positions, frame.springs, marked))

    return shoot


def room(schedule: ActuationSchedule) -> tuple[float, float]:
    """How far ahead and behind the camera must see [body lengths]: as far as the sampled robots go
    in all cycles, with three standard deviations to spare."""
    walk = schedule.predicted.walk
    if walk is None or walk.mean is None:
        return 1.3, 1.3
    part = (schedule.cycles + schedule.conditioning_cycles) / 5  # walks are predicted for five cycles
    mean, spread = part * walk.mean, part * (walk.spread or 0.0)
    return max(_LEAST_ROOM, mean + 3 * spread + _SPARE), max(_LEAST_ROOM, -mean + 3 * spread + _SPARE)
