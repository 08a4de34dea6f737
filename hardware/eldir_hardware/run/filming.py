"""Filming a run: the virtual camera, a live camera, and the calibration files that are kept with the log."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from eldir.built.ground import lay_on_table, place, surface_line
from eldir.built.robot import build
from eldir.core.records import FileRecord, FloatArray, IntArray
from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.terrain import Terrain
from eldir_hardware.camera.lens import Lens, require_not_expired
from eldir_hardware.camera.plane import FieldOfView, Image, Plane, TagBoard
from eldir_hardware.camera.projection import DiscPoses
from eldir_hardware.resource import Resource
from eldir_hardware.rig.addresses import hide_password
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import LiveCameraEntry, VirtualCameraEntry
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.rig import BodyFrame, DrivenBody

if TYPE_CHECKING:
    from eldir_hardware.vision.virtual_camera import VirtualCamera

_MIN_RANGE = 1.0
"""Shortest distance ahead and behind that the camera sees [body lengths]."""
_SPARE = 0.3  # [body lengths]
_ANY_WALK = (1.3, 1.3)  # ahead and behind, where no walk is predicted [body lengths]
MAX_FRAME_GAP = 1.0
"""A longer time without a frame is reported [s]."""
_CLOSING = 2.0  # longest wait for the thread at the end, which may wait for a picture [s]


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
    def load(cls, rig: Rig, rig_path: Path) -> CameraFiles:
        """Load the files that a rig file names. Raises `InputError` if one expired or does not fit."""
        if rig.camera is None:
            return cls()
        now, folder = datetime.now(UTC), rig_path.parent
        lens = None if rig.camera.lens is None else Lens.load(folder / rig.camera.lens)
        plane = None if rig.camera.plane is None else Plane.load(folder / rig.camera.plane)
        if lens is not None:
            require_not_expired(lens.provenance, now, str(rig.camera.lens))
            lens.require_size(rig.camera.width, rig.camera.height)
        if plane is not None:
            require_not_expired(plane.provenance, now, str(rig.camera.plane))
            plane.require_size(rig.camera.width, rig.camera.height)
        tags = rig.camera.tags if isinstance(rig.camera, LiveCameraEntry) else None
        return cls(lens, plane, None if tags is None else TagBoard.load(folder / tags))

    def attach_to(self, log: FilmLog) -> None:
        """Attach plane and tags; the recorder attaches the lens itself."""
        for name, file in (("plane.json", self.plane), ("tags.json", self.tags)):
            if file is not None:
                log.attach(name, file)


def virtual_camera(
    rig: Rig,
    entry: VirtualCameraEntry,
    body: DrivenBody,
    schedule: ActuationSchedule,
    terrain: Terrain | None = None,
) -> VirtualCamera:
    """The rig's virtual camera, far enough away to see all places that the robot should reach. `terrain`: the
    ground on the table, which it sees too; by default there is none."""
    return _render_camera(rig, entry, body.positions, visible_range(schedule), terrain)


def _render_camera(
    rig: Rig,
    entry: VirtualCameraEntry | LiveCameraEntry,
    positions: FloatArray,
    reach: tuple[float, float],
    terrain: Terrain | None,
) -> VirtualCamera:
    """A camera that sees a body from where it stands as far as it should `reach`, ahead and behind [body
    lengths], and the ground there."""
    from eldir_hardware.vision.virtual_camera import HUB_RADIUS, VirtualCamera

    view, size = FieldOfView.around(positions, *reach), (entry.width, entry.height)
    if terrain is not None:
        climbed = terrain.height(np.linspace(view.min_x, view.max_x, 200)).max()
        highest = float(climbed + np.ptp(positions[:, 1])) + 0.05
        view = replace(view, height=max(view.height, highest))
    camera = VirtualCamera(rig.virtual.seed, view, size=size, rate=entry.rate_hz, marker=rig.marker)
    if terrain is not None:
        # MuJoCo's heights count from the table, the engine's from the centre of a mass that stands on it.
        corner = 0.0 if rig.virtual.physics == "mujoco" else HUB_RADIUS
        camera.paint_ground(surface_line(terrain, positions, corner))
    return camera


def record_frames(
    camera: VirtualCamera, marked: IntArray, log: FilmLog, on_body: Callable[[BodyFrame], None]
) -> Callable[[BodyFrame], None]:
    """A function that renders the camera's picture of a body frame and records it."""
    log.attach("tags.json", camera.board)
    previous = 0.0

    def record(frame: BodyFrame) -> None:
        nonlocal previous
        if frame.time_s - previous > MAX_FRAME_GAP:
            log.on_stall(frame.time_s, frame.time_s - previous)
        previous = frame.time_s
        on_body(frame)
        if frame.discs is None:
            picture = camera.render(frame.positions, frame.springs, marked)
        else:
            picture = camera.render_solid(frame.discs, frame.springs, marked)
        log.on_frame(frame.time_s, picture)

    return record


def visible_range(schedule: ActuationSchedule) -> tuple[float, float]:
    """How far ahead and behind the camera must see [body lengths]: as far as the sampled robots go
    in all cycles, plus three standard deviations."""
    walk = schedule.predicted.walk
    if walk is None or walk.mean is None:
        return _ANY_WALK
    part = (schedule.cycles + schedule.conditioning_cycles) / 5  # walks are predicted for five cycles
    mean, spread = part * walk.mean, part * (walk.spread or 0.0)
    return max(_MIN_RANGE, mean + 3 * spread + _SPARE), max(_MIN_RANGE, -mean + 3 * spread + _SPARE)


class LiveCamera(Resource):
    """A live camera, between `open` and `close` or in a `with`.

    A thread reads its pictures all the time, so that no recorded picture has waited in the driver.
    """

    def __init__(self, entry: LiveCameraEntry):
        self._entry = entry
        self._record: Callable[[float, NDArray[np.uint8]], None] | None = None
        self._failure: EldirError | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)

    def open(self) -> None:
        """Take the first picture and start reading. Raises `InputError` where the camera cannot be opened, or
        its pictures have another size than the rig file says."""
        from eldir_hardware.vision.sources import CameraDevice

        entry = self._entry
        wanted = entry.width, entry.height
        self._frames = CameraDevice(entry.device, inf, size=wanted, rate=entry.rate_hz).frames()
        _, image = next(self._frames)
        found = image.shape[1::-1]
        if found != wanted:
            self._frames.close()
            raise InputError(
                f"the pictures of {hide_password(entry.device)} have another size than the rig file says",
                code="camera.other-size",
                expected=f"{wanted[0]} x {wanted[1]}",
                found=f"{found[0]} x {found[1]}",
                remedy="set camera.width and camera.height in the rig file, and calibrate for that size",
            )
        self._thread.start()

    def close(self) -> None:
        """Stop reading; a picture that does not come is not waited for."""
        self._closing.set()
        self._thread.join(_CLOSING)

    @contextmanager
    def filming(self, log: FilmLog) -> Iterator[Callable[[float], None]]:
        """A function that begins to record pictures, from a start [s of the monotonic clock] on.

        A camera that fails does not stop the run; its error is raised at the end.
        """
        start = latest = inf

        def begin(at: float) -> None:
            nonlocal start, latest
            start = latest = at
            self._record = record

        def record(t: float, image: NDArray[np.uint8]) -> None:
            nonlocal latest
            if t < start:
                return
            if t - latest > MAX_FRAME_GAP:
                log.on_stall(t - start, t - latest)
            latest = t
            log.on_frame(t - start, image)

        try:
            yield begin
        finally:
            self._record = None
            if (end := time.monotonic()) - latest > MAX_FRAME_GAP:
                log.on_stall(end - start, end - latest)
        if self._failure is not None:
            filmed = latest - start if latest < inf else 0.0
            raise EldirError(f"{self._failure}; the log has pictures until {filmed:.1f} s")

    def _read(self) -> None:
        with closing(self._frames):
            try:
                for t, image in self._frames:
                    if self._closing.is_set():
                        return
                    if (record := self._record) is not None:
                        record(t, image)
            except EldirError as error:
                self._failure = error


class RobotCamera:
    """Renders the robot of a design wherever its masses are."""

    def __init__(self, rig: Rig, design: Design):
        entry = rig.camera or VirtualCameraEntry(kind="virtual")
        self._springs, self._marked = design.morphology.springs, design.marks
        self.sees_discs = rig.virtual.dimensions == 3
        """Whether it needs the places of the discs of both faces, as of a robot that may leave its plane."""
        robot, terrain = build(design.morphology), lay_on_table(design)
        positions = place(robot, terrain)[:2].T
        self._camera = _render_camera(rig, entry, positions, _ANY_WALK, terrain)
        self.board = self._camera.board
        """The reference tags around the robot."""

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

    def render_solid(self, discs: DiscPoses) -> Image:
        """BGR picture (H, W, 3) of the robot with its discs where they are in space."""
        return self._camera.render_solid(discs, self._springs, self._marked)
