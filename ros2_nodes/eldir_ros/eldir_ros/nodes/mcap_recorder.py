# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The recorder: one MCAP log for each run, as `eldir rig drive` writes it, and the tracks."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from eldir_msgs.msg import BoardState, MotionPlane, ReferenceTags, Run
from sensor_msgs.msg import CameraInfo, CompressedImage
from visualization_msgs.msg import MarkerArray

from eldir.core.records import FileRecord
from eldir.design import Design
from eldir.errors import EldirError
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Plane
from eldir_hardware.guardian.measured_power import describe_correction
from eldir_hardware.log.background import RunRecording
from eldir_hardware.log.messages import HEAT_MODEL
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.vision.pipeline import FIRST_PICTURE_KEY
from eldir_ros.base.parameters import find_file, get_file, get_text
from eldir_ros.base.qualities import COMPLETE, LATCHED, PICTURES, pictures_quality
from eldir_ros.base.rig_node import ACTIVE, RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import board, marks, nanoseconds, pictures, reference, runs
from eldir_ros.conversions.schedules import schedule_from, without_predictions


class McapRecorderNode(RigNode):
    """Records from the message that a run begins until a moment after the message that it ended."""

    def __init__(self, **options: Any):
        super().__init__("mcap_recorder", **options)
        self._recording: RunRecording | None = None
        self._files: dict[str, FileRecord | bytes] = {}
        self._lens: Lens | None = None
        self._tags: FileRecord | bytes = b""
        self._start_ns = 0
        """Start of the run that is being written [ns]."""
        self._plane: Plane | None = None
        """The last plane that the tracker published."""
        self._has_plane = False
        """Whether the plane is attached to the present log."""
        self._info: dict[str, Any] | None = None
        """The latest calibrated lens that a camera driver published."""
        self._schedule: ActuationSchedule | None = None
        """The schedule of the file that the parameter names."""
        self.listen(Run, "run", self._on_run, LATCHED)
        self.listen(ReferenceTags, "camera/tags", self._on_tags, LATCHED)
        self.listen(MotionPlane, "camera/plane", self._on_plane, LATCHED)
        quality = pictures_quality(self)
        self.listen(CompressedImage, "camera/image_raw/compressed", self._on_picture, quality)
        self.listen(CameraInfo, "camera/camera_info", self._on_info, PICTURES)
        self.listen(MarkerArray, "marks", self._on_marks, COMPLETE)
        self.listen(BoardState, "relay_board/states", self._on_states, COMPLETE)
        self.every(0.2, self._tick)

    def open(self) -> None:
        names = ("design", "lens", "plane", "tags", "schedule")
        design, lens, plane, tags, schedule = (find_file(self, name) for name in names)
        self._rig = Rig.load(get_file(self, "rig"))
        self._schedule = None if schedule is None else ActuationSchedule.load(schedule)
        self._files = {"rig.yaml": self._rig.source}
        if design is not None:
            self._files["design.json"] = Design.load(design)
        if plane is not None:
            self._files["plane.json"] = Plane.load(plane)
        self._lens = None if lens is None else Lens.load(lens)
        if tags is not None:
            self._tags = tags.read_bytes()

    def halt(self) -> None:
        self._finish("the recorder was deactivated")

    def close(self) -> None:
        self._finish("the recorder was shut down")

    def on_silent_node(self, name: str) -> None:
        with self.transition:
            self._write(lambda log: log.on_fault(self.now_ns, name, "sends no heartbeats"))
            if name == "actuation_sequencer":  # no other node reports the end of the run
                self._finish("the sequencer sends no heartbeats")

    def on_emergency_stop(self, reason: str) -> None:
        with self.transition:
            self._write(lambda log: log.on_fault(self.now_ns, "emergency stop", reason))

    def _on_run(self, message: Run) -> None:
        if self.state != ACTIVE:
            return
        if message.state != Run.RUNNING:
            is_finished = message.state == Run.FINISHED
            self._write(lambda log: log.end(self.now_ns, time.monotonic(), message.message, is_finished))
            return
        self._finish("another run began")
        self._begin(message)

    def _begin(self, message: Run) -> None:
        start_ns = self._start_ns = nanoseconds(message.start)
        start = time.strftime("%Y%m%d-%H%M%S", time.localtime(1e-9 * start_ns))
        folder = Path(get_text(self, "folder")).expanduser()
        path = folder / f"run-{start}-{message.id}" / "log.mcap"  # each folder is a bag
        schedule = self._with_predictions(schedule_from(message.schedule))
        names = self._rig.channel_names, self._rig.spring_names
        try:
            recording = self._recording = RunRecording(
                path, *names, start_ns, self._lens, runs.room_of(message)
            )
            self._has_plane = False
            recording.attach({"schedule.json": schedule, **self._files})
            if correction := describe_correction(self._rig):
                recording.on_note(HEAT_MODEL, correction)
            if self._info is not None:
                recording.on_camera_info(start_ns, self._info)
            if self._tags:
                recording.attach({"tags.json": self._tags})
        except EldirError as error:
            self._fail(error)
            return
        self._attach_plane()
        self.get_logger().info(f"recording {path}")

    def _with_predictions(self, schedule: ActuationSchedule) -> ActuationSchedule:
        """The schedule of the file, with its predictions, if it is the one that is played."""
        given = self._schedule
        return given if given is not None and without_predictions(given) == schedule else schedule

    def _on_tags(self, message: ReferenceTags) -> None:
        if not get_text(self, "tags"):
            self._tags = reference.tags_from(message)

    def _on_plane(self, message: MotionPlane) -> None:
        self._plane = reference.plane_from(message)
        self._attach_plane()

    def _attach_plane(self) -> None:
        """Attach the plane in which this run is tracked, so that tracking its log gives the same positions.
        It may arrive before the message of the run, and one of earlier pictures after it."""
        plane = self._plane
        if plane is None or self._recording is None or self._has_plane or "plane.json" in self._files:
            return
        if plane.provenance.get(FIRST_PICTURE_KEY, self._start_ns) >= self._start_ns:
            self._has_plane = True
            self._write(lambda log: log.attach({"plane.json": plane}))

    def _on_picture(self, message: CompressedImage) -> None:
        stamp, data = nanoseconds(message.header.stamp), np.frombuffer(message.data, np.uint8)
        self._write(lambda log: log.on_picture(stamp, data))

    def _on_info(self, message: CameraInfo) -> None:
        """The lens from a camera's driver; a focal length of 0 means that it is not calibrated."""
        if message.k[0] and (self._recording is None or not self._recording.camera_known):
            stamp, info = nanoseconds(message.header.stamp), pictures.info_from(message)
            self._info = info
            self._write(lambda log: log.on_camera_info(stamp, info))

    def _on_marks(self, message: MarkerArray) -> None:
        if message.markers:
            stamp, names, positions = marks.tracks_from(message)
            self._write(lambda log: log.on_tracks(stamp, names, positions))

    def _on_states(self, message: BoardState) -> None:
        state = board.state_from(message)
        self._write(
            lambda log: log.on_board(
                state.stamp, state.closed, state.temperatures, state.currents, state.voltages
            )
        )

    def _write(self, write: Callable[[RunRecording], None]) -> None:
        if self._recording is not None:
            try:
                write(self._recording)
            except EldirError as error:
                self._fail(error)

    def _tick(self) -> None:
        if self._recording is not None and self._recording.is_due(time.monotonic()):
            self._finish("")

    def _finish(self, reason: str) -> None:
        """Close the log. `reason`: why, if no message said how the run ended."""
        recording, self._recording = self._recording, None
        if recording is None:
            return
        try:
            recording.close(self.now_ns, reason)
        except EldirError as error:
            self._fail(error)
            return
        self.get_logger().info(f"wrote {recording.path}")

    def _fail(self, error: EldirError) -> None:
        """Give up a log that cannot be written; what was written is kept."""
        self._recording = None
        self.report_fault(str(error))


def main() -> None:
    """`ros2 run eldir_ros mcap_recorder`."""
    spin([McapRecorderNode])
