# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The mass tracker: where m1 to m5 are, in metres in the plane of motion, picture by picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from diagnostic_updater import FrequencyStatusParam, HeaderlessTopicDiagnostic
from eldir_msgs.msg import MotionPlane, ReferenceTags, Run
from geometry_msgs.msg import PointStamped, PoseArray
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, CompressedImage
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from eldir.core.records import FloatArray
from eldir.design import Design
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Plane, TagBoard, estimate_camera_pose
from eldir_hardware.log.reader import read_attachment
from eldir_hardware.markers.registration import DEFAULT_KIND, require_kind
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.vision.pipeline import LiveOverlay, LiveTracker
from eldir_hardware.vision.printed_ground import predict_ground
from eldir_hardware.vision.recording_setup import (
    find_recorded_lens,
    find_recorded_plane,
    marker_layout,
    read_attached_board,
    read_attached_design,
)
from eldir_hardware.vision.sources import LoggedFrames, open_source
from eldir_ros.base.frames import frame_name
from eldir_ros.base.parameters import find_file, get_file, get_number, get_text
from eldir_ros.base.qualities import COMPLETE, LATCHED, NEWEST, RELIABLE, STATIC, pictures_quality
from eldir_ros.base.rig_node import ACTIVE, RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import detections, frames, marks, nanoseconds, pictures, reference


class MassTrackerNode(RigNode):
    """Publishes the tracks that `eldir_hardware.vision.pipeline.LiveTracker` finds in the pictures."""

    def __init__(self, **options: Any):
        super().__init__("mass_tracker", **options)
        self._points: dict[str, Publisher[PointStamped]] = {}
        self._poses = self.advertise(PoseArray, "marks/poses", RELIABLE)
        self._markers = self.advertise(MarkerArray, "marks", COMPLETE)
        self._detections: Publisher[Any] | None = None
        if detections.is_available():
            from vision_msgs.msg import Detection2DArray

            self._detections = self.advertise(Detection2DArray, "marks/detections", RELIABLE)
        self._overlays = self.advertise(CompressedImage, "marks/overlay/compressed", RELIABLE)
        quality = pictures_quality(self)
        self.listen(CompressedImage, "camera/image_raw/compressed", self._on_picture, quality)
        self.listen(ReferenceTags, "camera/tags", self._on_tags, LATCHED)
        self.listen(CameraInfo, "camera/camera_info", self._on_info, NEWEST)
        self._frames = self.advertise(TFMessage, "/tf_static", STATIC)
        self._planes = self.advertise(MotionPlane, "camera/plane", LATCHED)
        self._published_plane: Plane | None = None
        self._focal = 0.0
        """Focal length from camera_info [px]; 0 while it is unknown."""
        self.listen(Run, "run", self._on_run, LATCHED)
        self._rate = HeaderlessTopicDiagnostic(
            "tracks", self.diagnostics, FrequencyStatusParam({"min": 5.0, "max": 120.0})
        )
        self._ground = frame_name(self, marks.FRAME_ID)
        self._camera = frame_name(self, pictures.FRAME_ID)
        self._received_board: TagBoard | None = None
        self._tracker: LiveTracker | None = None
        self._overlay = LiveOverlay(())
        self._logged_notes = 0
        self._tracked_ns = 0
        """Stamp of the latest picture [ns]."""
        self._start_ns: int | None = None
        """Start of the run [ns]; earlier pictures are not tracked."""

    def open(self) -> None:
        log, tags, plane = (find_file(self, name) for name in ("log", "tags", "plane"))
        board: TagBoard | None = None
        lens: Lens | None = None
        rig = None if (path := find_file(self, "rig")) is None else Rig.load(path)
        fixed_plane = None if plane is None else Plane.load(plane)
        if log is not None:
            source = open_source(log)
            design, board = read_attached_design(source), read_attached_board(source)
            lens = find_recorded_lens(source)
            rig = read_attachment(source.attachments, source.name, "rig.yaml", Rig.from_json)
            if plane is None and "plane.json" in source.attachments:  # as `eldir track` tracks this log
                fixed_plane = find_recorded_plane(source)
            if isinstance(source, LoggedFrames):
                self._start_ns = source.log.epoch_ns
        else:
            design = Design.load(get_file(self, "design"))
        board = board if tags is None else TagBoard.load(tags)
        layout = None if design is None else marker_layout(design)
        ground = None if design is None else predict_ground(design, rig)
        marker = get_text(self, "marker") or (DEFAULT_KIND if rig is None else rig.marker)
        self._tracker = LiveTracker(board, fixed_plane, layout, require_kind(marker), ground, lens)
        self.get_logger().info(f"markers: {marker}")
        if self._received_board is not None:
            self._tracker.set_board(self._received_board)
        for name in set(self._tracker.names) - set(self._points):
            self._points[name] = self.advertise(PointStamped, f"marks/{name}", RELIABLE)

    def start(self) -> None:
        if self._tracker is not None:
            self._tracker.reset(self._start_ns)
            self._overlay = LiveOverlay(self._tracker.names)

    def _on_tags(self, message: ReferenceTags) -> None:
        self._received_board = reference.tags_from(message)
        if self._tracker is not None:
            self._tracker.set_board(self._received_board)

    def _on_info(self, message: CameraInfo) -> None:
        focal = float(message.k[0] + message.k[4]) / 2
        if focal != self._focal:
            self._focal, self._published_plane = focal, None

    def _on_run(self, message: Run) -> None:
        """Each run is tracked from its own pictures alone, as `eldir track` tracks its log."""
        if message.state == Run.RUNNING:
            self._start_ns = nanoseconds(message.start)
            if self._tracked_ns >= self._start_ns:
                self.get_logger().warning(
                    f"run {message.id} began before this node received its message: its first positions use "
                    "the previous plane, and differ by micrometres from those of `eldir track`"
                )
            self.start()
            self.get_logger().info(f"run {message.id}: tracked from its own pictures")

    def _on_picture(self, message: CompressedImage) -> None:
        stamp = nanoseconds(message.header.stamp)
        is_early = self._start_ns is not None and stamp < self._start_ns
        if self._tracker is None or self.state != ACTIVE or is_early:
            return
        self._tracked_ns = stamp
        tracked = self._tracker.update(stamp, pictures.picture_from(message))
        if self._tracker.plane is not None and self._tracker.plane is not self._published_plane:
            self._publish_plane(self._tracker.plane, stamp)
        for note in self._tracker.notes[self._logged_notes :]:
            self.get_logger().warning(note)
        self._logged_notes = len(self._tracker.notes)
        for at, positions, picture in tracked:
            self._publish(self._tracker, at, positions, picture)

    def _publish_plane(self, plane: Plane, stamp: int) -> None:
        """Publish the plane for the recorder, and the camera's frames, which need the focal length."""
        self._published_plane = plane
        self._planes.publish(reference.plane_of(plane, self._ground))
        if self._focal > 0:
            names = (self._ground, frame_name(self, frames.CAMERA), self._camera)
            pose = estimate_camera_pose(plane, self._focal)
            self._frames.publish(frames.camera_frames_of(stamp, pose, *names))

    def _publish(
        self, tracker: LiveTracker, stamp: int, positions: FloatArray, picture: NDArray[np.uint8]
    ) -> None:
        for name, position in zip(tracker.names, positions, strict=True):
            if np.isfinite(position).all():
                self._points[name].publish(marks.point_of(stamp, position, self._ground))
        if np.isfinite(positions).all():  # poses have no names, so the array needs all of them
            self._poses.publish(marks.poses_of(stamp, positions, self._ground))
        self._markers.publish(marks.markers_of(stamp, tracker.names, positions, self._ground))
        if self._detections is not None and tracker.plane is not None:
            self._detections.publish(
                detections.detections_of(stamp, tracker.names, positions, tracker.plane, self._camera)
            )
        self._rate.tick()
        t = 1e-9 * stamp
        self._overlay.add(t, positions)
        due = self._overlay.is_due(t, get_number(self, "overlay_period_s"))
        if due and tracker.plane is not None and self._overlays.get_subscription_count():
            drawing = self._overlay.draw(picture, tracker.plane, tracker.ground)
            self._overlays.publish(pictures.compressed_of(stamp, drawing, "png", self._camera))


def main() -> None:
    """`ros2 run eldir_ros mass_tracker`."""
    spin([MassTrackerNode])
