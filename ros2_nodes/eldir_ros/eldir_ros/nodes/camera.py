# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The camera: pictures from any source of the toolkit, or of the virtual rig's robot."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_updater import FrequencyStatusParam, HeaderlessTopicDiagnostic
from eldir_msgs.msg import ReferenceTags
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from eldir.errors import EldirError
from eldir_hardware.camera.lens import Lens
from eldir_hardware.images import jpeg
from eldir_hardware.rig.addresses import is_camera
from eldir_hardware.run.filming import RobotCamera
from eldir_hardware.vision.recording_setup import load_recorded_lens
from eldir_hardware.vision.sources import timed_pictures
from eldir_ros.base.frames import frame_name
from eldir_ros.base.parameters import find_file, get_file, get_number, get_text, get_texts
from eldir_ros.base.qualities import ALL_PICTURES, LATCHED, NEWEST, RELIABLE
from eldir_ros.base.rig_node import ACTIVE, RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import marks, nanoseconds, pictures, reference


class CameraNode(RigNode):
    """Publishes image_raw, its compressed form, and camera_info."""

    def __init__(self, **options: Any):
        super().__init__("camera", **options)
        self._compressed = self.advertise(CompressedImage, "camera/image_raw/compressed", ALL_PICTURES)
        self._raw = self.advertise(Image, "camera/image_raw", RELIABLE)
        self._info = self.advertise(CameraInfo, "camera/camera_info", RELIABLE)
        self._tags = self.advertise(ReferenceTags, "camera/tags", LATCHED)
        self.listen(PoseArray, "bench/masses", self._on_masses, NEWEST)
        self.listen(PoseArray, "bench/discs", self._on_discs, NEWEST)
        self._rate = HeaderlessTopicDiagnostic(
            "pictures", self.diagnostics, FrequencyStatusParam({"min": 5.0, "max": 120.0})
        )
        self._frame = frame_name(self, pictures.FRAME_ID)
        self._ground = frame_name(self, marks.FRAME_ID)
        self._virtual: RobotCamera | None = None
        self._lens: Lens | None = None
        self._size: tuple[int, int] | None = None
        self._playback: threading.Thread | None = None
        self._halt_event = threading.Event()

    def open(self) -> None:
        source, lens = get_text(self, "source"), find_file(self, "lens")
        if source == "virtual":
            self._virtual = RobotCamera.load(get_file(self, "rig"), get_file(self, "design"))
        elif not is_camera(source) and not Path(source).exists():
            raise EldirError(f"{source} does not exist", remedy="set the parameter source")
        if lens is not None:
            self._lens = Lens.load(lens)
        else:
            self._lens = load_recorded_lens(source) if self._virtual is None else self._virtual.lens

    def start(self) -> None:
        self._halt_event.clear()
        self._size = None
        if self._virtual is not None:
            self._tags.publish(reference.tags_of(self._virtual.board, self._ground))
        else:
            self._playback = threading.Thread(target=self._play, name="pictures", daemon=True)
            self._playback.start()

    def halt(self) -> None:
        self._halt_event.set()
        if self._playback is not None:
            self._playback.join()
            self._playback = None

    def close(self) -> None:
        self.halt()
        self._virtual = None

    def _on_masses(self, message: PoseArray) -> None:
        """Render the virtual robot at its new position."""
        if self._virtual is not None and not self._virtual.sees_discs and self.state == ACTIVE:
            self._show(message, self._virtual.render(marks.positions_from(message)))

    def _on_discs(self, message: PoseArray) -> None:
        """Render a virtual robot that may leave its plane."""
        if self._virtual is not None and self._virtual.sees_discs and self.state == ACTIVE:
            self._show(message, self._virtual.render_solid(marks.discs_from(message)))

    def _show(self, message: PoseArray, picture: NDArray[np.uint8]) -> None:
        """Publish the picture of a robot at the stamp of its place."""
        self._publish(nanoseconds(message.header.stamp), jpeg.encode(picture).tobytes(), picture)

    def _play(self) -> None:
        """Publish the pictures of a source when they are due."""
        speed = get_number(self, "speed")
        while self.heartbeats.missing(get_texts(self, "wait_for"), time.monotonic()):
            if self._halt_event.wait(0.1):
                return
        count, start, start_ns = 0, time.monotonic(), self.now_ns
        source = get_text(self, "source")
        try:
            for picture in timed_pictures(source, get_number(self, "rate_hz")):
                if count == 0:  # opening a camera takes a while
                    start, start_ns = time.monotonic(), self.now_ns
                if self._halt_event.wait(max(start + picture.due / speed - time.monotonic(), 0.0)):
                    return
                due_ns = start_ns + round(1e9 * picture.due / speed)
                self._publish(due_ns if picture.stamp_ns is None else picture.stamp_ns, picture.data, None)
                count += 1
        except EldirError as error:
            self.report_fault(str(error))
            return
        self.get_logger().info(f"{source}: all {count} pictures shown")

    def _publish(self, stamp: int, data: bytes, picture: NDArray[np.uint8] | None) -> None:
        self._compressed.publish(pictures.compressed_of(stamp, data, frame=self._frame))
        raw, info = (p.get_subscription_count() > 0 for p in (self._raw, self._info))
        if raw or (info and self._size is None):
            picture = jpeg.decode(np.frombuffer(data, np.uint8)) if picture is None else picture
            self._size = (picture.shape[1], picture.shape[0])
        if info and self._size is not None:
            self._info.publish(pictures.info_of(stamp, *self._size, self._lens, self._frame))
        if raw and picture is not None:
            self._raw.publish(pictures.raw_of(stamp, picture, self._frame))
        self._rate.tick()


def main() -> None:
    """`ros2 run eldir_ros camera`."""
    spin([CameraNode])
