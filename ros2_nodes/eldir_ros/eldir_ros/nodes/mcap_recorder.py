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

from eldir.core.files import parse_json
from eldir.core.records import FileRecord
from eldir.design import Design
from eldir.errors import EldirError
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Plane, TagBoard
from eldir_hardware.guardian.measured_power import describe_correction
from eldir_hardware.log.background import RunRecording
from eldir_hardware.log.messages import HEAT_MODEL
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.vision.pipeline import FIRST_PICTURE_KEY
from eldir_ros.base.interfaces import (
    COMPLETE,
    LATCHED,
    PICTURES,
    declare_pictures,
    declare_text,
    find_file,
    get_file,
    get_value,
)
from eldir_ros.base.rig_node import RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import board, marks, nanoseconds, pictures, runs


class McapRecorderNode(RigNode):
    """Records from the message that a run begins until a moment after the message that it ended."""

    def __init__(self, **options: Any):
        super().__init__("mcap_recorder", **options)
        declare_text(self, "rig", "Rig file (YAML, eldir-rig/1), attached to each log.")
        declare_text(self, "design", "Design file, attached to each log.")
        declare_text(self, "tags", "File of the reference tags. Default: the tags on the topic camera/tags.")
        declare_text(
            self, "lens", "Lens file of the camera, attached to each log and written as camera_info."
        )
        declare_text(self, "plane", "File of a calibrated plane, attached to each log.")
        declare_text(self, "folder", "Folder for the logs.", ".")
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
        image = "sensor_msgs/msg/CompressedImage"
        for name, topic, callback, quality in (
            ("eldir_msgs/msg/Run", "run", self._on_run, LATCHED),
            ("std_msgs/msg/String", "camera/tags", self._on_tags, LATCHED),
            ("std_msgs/msg/String", "camera/plane", self._on_plane, LATCHED),
            (image, "camera/image_raw/compressed", self._on_picture, declare_pictures(self)),
            ("sensor_msgs/msg/CameraInfo", "camera/camera_info", self._on_info, PICTURES),
            ("visualization_msgs/msg/MarkerArray", "marks", self._on_marks, COMPLETE),
            ("eldir_msgs/msg/BoardState", "relay_board/states", self._on_states, COMPLETE),
        ):
            self.listen(name, topic, callback, quality)
        self.every(0.2, self._tick)

    def open(self) -> None:
        rig, (design, lens, plane, tags) = (
            get_file(self, "rig"),
            (find_file(self, name) for name in ("design", "lens", "plane", "tags")),
        )
        self._rig = Rig.load(rig)
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

    def _on_run(self, message: Any) -> None:
        if self.state != "active":
            return
        if message.state != runs.RUNNING:
            is_finished = message.state == runs.RUN_FINISHED
            self._write(lambda log: log.end(self.now_ns, time.monotonic(), message.message, is_finished))
            return
        self._finish("another run began")
        self._begin(message)

    def _begin(self, message: Any) -> None:
        start_ns = self._start_ns = nanoseconds(message.start)
        start = time.strftime("%Y%m%d-%H%M%S", time.localtime(1e-9 * start_ns))
        folder = Path(get_value(self, "folder")).expanduser()
        path = folder / f"run-{start}-{message.id}" / "log.mcap"  # each folder is a bag
        schedule = runs.schedule_from(message.schedule)
        names = board.channel_names(self._rig), board.spring_names(self._rig)
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

    def _on_tags(self, message: Any) -> None:
        if not get_value(self, "tags"):
            self._tags = TagBoard.from_json(parse_json(message.data, "camera/tags"))

    def _on_plane(self, message: Any) -> None:
        self._plane = Plane.from_json(parse_json(message.data, "camera/plane"))
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

    def _on_picture(self, message: Any) -> None:
        stamp, data = nanoseconds(message.header.stamp), np.frombuffer(message.data, np.uint8)
        self._write(lambda log: log.on_picture(stamp, data))

    def _on_info(self, message: Any) -> None:
        """The lens from a camera's driver; a focal length of 0 means that it is not calibrated."""
        if message.k[0] and (self._recording is None or not self._recording.camera_known):
            stamp, info = nanoseconds(message.header.stamp), pictures.info_from(message)
            self._info = info
            self._write(lambda log: log.on_camera_info(stamp, info))

    def _on_marks(self, message: Any) -> None:
        if message.markers:
            stamp, names, positions = marks.tracks_from(message)
            self._write(lambda log: log.on_tracks(stamp, names, positions))

    def _on_states(self, message: Any) -> None:
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
