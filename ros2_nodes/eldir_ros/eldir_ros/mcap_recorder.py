"""The recorder: one MCAP log a run, as `eldir rig drive` writes it, with the tracks besides."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from calibration.camera.lens import Lens
from calibration.camera.plane import Plane
from eldir.design import Design
from eldir.errors import EldirError
from eldir_ros import parameters
from eldir_ros.conversions import board, marks, nanoseconds, pictures, runs
from eldir_ros.messages import COMPLETE, LATCHED, PICTURES, class_of
from eldir_ros.process import spin
from eldir_ros.rig_node import RigNode
from hardware.log.background import BackgroundRecorder
from hardware.log.recorder import Recorder
from hardware.rig.configuration import Rig

_AFTER = 1.5  # tracks and reports of the run's last moment come later than its end [s]


class McapRecorder(RigNode):
    """Records from the announcement of a run until a moment after its end."""

    def __init__(self, **options: Any):
        super().__init__("mcap_recorder", **options)
        parameters.text(self, "rig", "Rig file (YAML, eldir-rig/1), kept with each log.")
        parameters.text(self, "design", "Design file, kept with each log.")
        parameters.text(self, "tags", "File of the fixed tags; without it those that the camera tells of.")
        parameters.text(self, "lens", "Lens file of the camera, kept with each log and told as camera_info.")
        parameters.text(self, "plane", "File of a calibrated plane, kept with each log.")
        parameters.text(self, "folder", "Folder for the logs.", ".")
        self.latest: Path | None = None
        """The log of the last run."""
        self._recorder: BackgroundRecorder | None = None
        self._epoch = 0
        self._lens: Lens | None = None
        self._until: float | None = None
        self._end: int | None = None
        self._tags = b""
        self._size: tuple[int, int] | None = None
        self._info: dict[str, Any] | None = None
        subscribe = self.create_subscription
        subscribe(class_of("eldir_msgs/msg/Run"), "run", self._on_run, LATCHED)
        subscribe(class_of("std_msgs/msg/String"), "camera/tags", self._on_tags, LATCHED)
        subscribe(
            class_of("sensor_msgs/msg/CompressedImage"),
            "camera/image_raw/compressed",
            self._on_picture,
            PICTURES,
        )
        subscribe(class_of("sensor_msgs/msg/CameraInfo"), "camera/camera_info", self._on_info, PICTURES)
        subscribe(class_of("visualization_msgs/msg/MarkerArray"), "marks", self._on_marks, COMPLETE)
        subscribe(
            class_of("control_msgs/msg/DynamicJointState"), "relay_board/states", self._on_states, COMPLETE
        )
        self.create_timer(0.2, self._tick)

    def open(self) -> None:
        rig_path = parameters.path(self, "rig")
        design = parameters.path(self, "design", needed=False)
        self._rig = Rig.load(rig_path)  # type: ignore[arg-type]
        self._files = {"rig.yaml": rig_path.read_bytes()}  # type: ignore[union-attr]
        if design is not None:
            self._files["design.json"] = _json(Design.load(design).to_json())
        lens = parameters.path(self, "lens", needed=False)
        self._lens = None if lens is None else Lens.load(lens)
        plane = parameters.path(self, "plane", needed=False)
        if plane is not None:
            self._files["plane.json"] = _json(Plane.load(plane).to_json())
        tags = parameters.path(self, "tags", needed=False)
        if tags is not None:
            self._tags = tags.read_bytes()

    def rest(self) -> None:
        self._finish("the recorder was deactivated", good=False)

    def close(self) -> None:
        self._finish("the recorder was shut down", good=False)

    def miss(self, name: str) -> None:
        self._tell(name, "has fallen silent")
        if name == "actuation_sequencer":  # nobody else would say that the run is over
            self._finish("the sequencer has fallen silent", good=False)

    def obey_stop(self, reason: str) -> None:
        self._tell("emergency stop", reason)

    def _on_run(self, message: Any) -> None:
        if self.state != "active":
            return
        if message.state != runs.RUNNING:
            self._end = nanoseconds(message.start) if self._recorder is None else self.now_ns
            self._until = time.monotonic() + _AFTER
            self._ending = (message.message, message.state == runs.RUN_FINISHED)
            return
        self._finish("another run began", good=False)
        self._begin(message)

    def _begin(self, message: Any) -> None:
        self._epoch = nanoseconds(message.start)
        begun = time.strftime("%Y%m%d-%H%M%S", time.localtime(1e-9 * self._epoch))
        folder = Path(parameters.value(self, "folder")).expanduser()
        self.latest = folder / f"run-{begun}-{message.id}" / "log.mcap"  # a folder is a bag
        names = board.channel_names(self._rig), board.spring_names(self._rig)
        recorder = BackgroundRecorder(Recorder(self.latest, *names, self._epoch, self._lens))
        schedule = _json(runs.schedule_from(message.schedule).to_json())
        try:
            recorder.open()
            self._recorder = recorder
            recorder.attach("schedule.json", "application/json", schedule)
            for name, data in self._files.items():
                kind = "application/yaml" if name.endswith("yaml") else "application/json"
                recorder.attach(name, kind, data)
            if self._info is not None:
                recorder.on_camera_info(0.0, self._info)
            if self._tags:
                recorder.attach("tags.json", "application/json", self._tags)
        except EldirError as error:
            self._fail(error)
            return
        self._until = self._end = None
        self.get_logger().info(f"recording {self.latest}")

    def _on_tags(self, message: Any) -> None:
        if not parameters.value(self, "tags"):
            self._tags = _json(json.loads(message.data))

    def _on_picture(self, message: Any) -> None:
        stamp = nanoseconds(message.header.stamp)
        data = np.frombuffer(message.data, np.uint8)
        if self._recorder is not None and self._size is None:
            from hardware.images import jpeg

            height, width = jpeg.decode(data).shape[:2]
            self._size = (width, height)
        self._write(stamp, lambda log, t: log.on_picture(t, data, *self._size))  # type: ignore[misc]

    def _on_info(self, message: Any) -> None:
        """The lens that a camera's driver knows, once a log; a lens file, where there is one, tells it."""
        if self._lens is not None or not message.k[0] or (self._info and self._recorder):
            return
        info = self._info = pictures.info_from(message)
        self._write(nanoseconds(message.header.stamp), lambda log, t: log.on_camera_info(t, info), early=True)

    def _on_marks(self, message: Any) -> None:
        if message.markers:
            stamp, names, places = marks.tracks_from(message)
            self._write(stamp, lambda log, t: log.on_tracks(t, names, places))

    def _on_states(self, message: Any) -> None:
        state = board.state_from(message)

        def write(log: BackgroundRecorder, t: float) -> None:
            log.on_relays(t, state.closed)
            log.on_temperatures(t, state.temperatures)

        # Also while arming: everything is proven off before the start.
        self._write(state.stamp, write, early=True)

    def _write(
        self, stamp: int, write: Callable[[BackgroundRecorder, float], None], early: bool = False
    ) -> None:
        """What belongs to the run; pictures and tracks from its start on, as in the library's log."""
        if self._recorder is None or (stamp < self._epoch and not early):
            return
        if self._end is not None and stamp > self._end:
            return
        try:
            write(self._recorder, (stamp - self._epoch) * 1e-9)
        except EldirError as error:
            self._fail(error)

    def _tell(self, name: str, message: str) -> None:
        stamp = self.now_ns
        self._write(stamp, lambda log, t: log.on_status(t, name, message, good=False), early=True)

    def _tick(self) -> None:
        if self._until is not None and time.monotonic() > self._until:
            self._finish(*self._ending)

    def _finish(self, message: str, good: bool) -> None:
        recorder, self._until = self._recorder, None
        if recorder is None:
            return
        end = self.now_ns if self._end is None else self._end
        try:
            recorder.on_status((end - self._epoch) * 1e-9, "player", message, good=good)
            recorder.close()
        except EldirError as error:
            self._fail(error)
            return
        self._recorder = None
        self.get_logger().info(f"wrote {self.latest}")

    def _fail(self, error: EldirError) -> None:
        """A log that cannot be written is given up; what it holds is kept."""
        self._recorder = None
        self.trouble(str(error))


def _json(values: Any) -> bytes:
    return (json.dumps(values, indent=1) + "\n").encode()


def main() -> None:
    """`ros2 run eldir_ros mcap_recorder`."""
    spin([McapRecorder])
