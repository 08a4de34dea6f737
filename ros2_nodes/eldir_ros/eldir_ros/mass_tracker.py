"""The mass tracker: where m1 to m5 are, in metres in the plane of motion, picture by picture."""

from __future__ import annotations

import json
from collections import deque
from typing import Any

import numpy as np
from diagnostic_updater import FrequencyStatusParam, HeaderlessTopicDiagnostic
from numpy.typing import NDArray

from calibration.camera.plane import Plane, TagBoard
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.errors import EldirError
from eldir.trajectory import Trajectory
from eldir_ros import parameters
from eldir_ros.conversions import marks, nanoseconds, pictures, runs
from eldir_ros.messages import COMPLETE, LATCHED, PICTURES, RELIABLE, class_of, make
from eldir_ros.process import spin
from eldir_ros.rig_node import RigNode
from hardware.images.mark_sheet import PALETTE

_TRAIL = 600  # positions of the marks that the overlay shows, at most


class MassTracker(RigNode):
    """Tracks the marks as `eldir track` does: the plane from the first pictures, then every picture."""

    def __init__(self, **options: Any):
        super().__init__("mass_tracker", **options)
        parameters.text(self, "design", "Design file: which masses carry marks, and where they lie.")
        parameters.text(self, "log", "Log of a run, instead of design and tags: it holds both.")
        parameters.text(self, "tags", "File of the fixed tags; without it those that the camera tells of.")
        parameters.text(self, "plane", "File of a calibrated plane, instead of tags.")
        parameters.number(self, "overlay_period", "From one overlay picture to the next [s].", 2.0, 0.5, 60.0)
        self._points: dict[str, Any] = {}
        self._poses = self.create_publisher(class_of("geometry_msgs/msg/PoseArray"), "marks/poses", RELIABLE)
        self._markers = self.create_publisher(
            class_of("visualization_msgs/msg/MarkerArray"), "marks", COMPLETE
        )
        self._overlay = self.create_publisher(
            class_of("sensor_msgs/msg/CompressedImage"), "marks/overlay/compressed", RELIABLE
        )
        self.create_subscription(
            class_of("sensor_msgs/msg/CompressedImage"),
            "camera/image_raw/compressed",
            self._on_picture,
            PICTURES,
        )
        self.create_subscription(class_of("std_msgs/msg/String"), "camera/tags", self._on_tags, LATCHED)
        self.create_subscription(class_of("eldir_msgs/msg/Run"), "run", self._on_run, LATCHED)
        self._rate = HeaderlessTopicDiagnostic(
            "tracks", self.diagnostics, FrequencyStatusParam({"min": 5.0, "max": 120.0})
        )
        self._board: TagBoard | None = None
        self._layout: FloatArray | None = None
        self._plane: Plane | None = None
        self._tracker: Any = None
        self._waiting: list[tuple[int, NDArray[np.uint8]]] = []
        self._trail: deque[tuple[float, FloatArray]] = deque(maxlen=_TRAIL)
        self._drawn = -float("inf")
        self._epoch: int | None = None
        """Times of the tracker count from here [ns]."""

    def open(self) -> None:
        from hardware.log.reader import read_log
        from hardware.vision.recording_setup import attached_layout, layout_of
        from hardware.vision.sources import open_source

        log = parameters.path(self, "log", needed=False)
        if log is not None:
            source = open_source(log)
            self._layout = attached_layout(source)
            self._epoch = read_log(log).epoch_ns
            if "tags.json" in source.attachments:
                self._board = TagBoard.from_json(json.loads(source.attachments["tags.json"]))
        else:
            self._layout = layout_of(Design.load(parameters.path(self, "design")))  # type: ignore[arg-type]
        tags = parameters.path(self, "tags", needed=False)
        plane = parameters.path(self, "plane", needed=False)
        if tags is not None:
            self._board = TagBoard.load(tags)
        self._plane = None if plane is None else Plane.load(plane)
        for name in set(self._names) - set(self._points):
            self._points[name] = self.create_publisher(
                class_of("geometry_msgs/msg/PointStamped"), f"marks/{name}", RELIABLE
            )

    def start(self) -> None:
        self._tracker = None
        self._waiting.clear()
        self._trail.clear()

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(PALETTE)[: None if self._layout is None else len(self._layout)]

    def _on_tags(self, message: Any) -> None:
        if self._board is None:
            self._board = TagBoard.from_json(json.loads(message.data))

    def _on_run(self, message: Any) -> None:
        """A run is tracked from its own pictures alone, as `eldir track` tracks its log."""
        if message.state == runs.RUNNING:
            self._epoch = nanoseconds(message.start)
            self.start()

    def _on_picture(self, message: Any) -> None:
        stamp = nanoseconds(message.header.stamp)
        if self.state != "active" or (self._epoch is not None and stamp < self._epoch):
            return
        try:
            self._track(stamp, pictures.picture_from(message))
        except EldirError as error:
            self.trouble(str(error))
            self._waiting.clear()

    def _track(self, stamp: int, picture: NDArray[np.uint8]) -> None:
        """The first pictures are kept until they have given the plane, and are then tracked too."""
        from calibration.camera.tags import calibrate_plane
        from hardware.vision.recording_setup import CALIBRATION_FRAMES
        from hardware.vision.tracker import Tracker

        self._waiting.append((stamp, picture))
        if self._tracker is None:
            plane = self._plane
            if plane is None:
                if self._board is None or len(self._waiting) < CALIBRATION_FRAMES:
                    self._waiting = self._waiting[-CALIBRATION_FRAMES:]
                    return
                images = [image for _, image in self._waiting]
                plane = calibrate_plane(images, self._board, {"source": "camera/image_raw"})
            self._tracker = Tracker(plane, self._names, self._layout)
        waiting, self._waiting = self._waiting, []
        self._epoch = waiting[0][0] if self._epoch is None else self._epoch
        for at, image in waiting:
            self._publish(at, self._tracker.update(image, 1e-9 * (at - self._epoch)), image)

    def _publish(self, stamp: int, places: FloatArray, picture: NDArray[np.uint8]) -> None:
        for name, place in zip(self._names, places, strict=True):
            if np.isfinite(place).all():
                self._points[name].publish(marks.point_of(make, stamp, place))
        if np.isfinite(places).all():  # an array has no names: it holds all, or says nothing
            self._poses.publish(marks.poses_of(make, stamp, places))
        self._markers.publish(marks.markers_of(make, stamp, self._names, places))
        self._rate.tick()
        self._trail.append((1e-9 * stamp, places))
        period = parameters.value(self, "overlay_period")
        if 1e-9 * stamp - self._drawn >= period and self._overlay.get_subscription_count():
            self._drawn = 1e-9 * stamp
            self._overlay.publish(pictures.compressed_of(make, stamp, self._drawing(picture), "png"))

    def _drawing(self, picture: NDArray[np.uint8]) -> bytes:
        from hardware.vision.pipeline import overlay

        times, places = zip(*self._trail, strict=True)
        trajectory = Trajectory(self._names, np.array(times), np.array(places))
        return overlay(picture, self._tracker.plane, trajectory)


def main() -> None:
    """`ros2 run eldir_ros mass_tracker`."""
    spin([MassTracker])
