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
from numpy.typing import NDArray

from eldir.errors import EldirError
from eldir_hardware.camera.lens import Lens
from eldir_hardware.images import jpeg
from eldir_hardware.rig.addresses import is_camera
from eldir_hardware.run.filming import RobotCamera
from eldir_hardware.vision.recording_setup import load_recorded_lens
from eldir_hardware.vision.sources import timed_pictures
from eldir_ros.base.interfaces import (
    ALL_PICTURES,
    LATCHED,
    NEWEST,
    RELIABLE,
    declare_number,
    declare_text,
    declare_texts,
    find_file,
    frame_name,
    get_file,
    get_value,
    new_message,
)
from eldir_ros.base.rig_node import RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import marks, nanoseconds, pictures

_SOURCE = "A camera such as camera:0 or /dev/video0, a video, a folder of pictures, a log; or: virtual."


class CameraNode(RigNode):
    """Publishes image_raw, its compressed form, and camera_info."""

    def __init__(self, **options: Any):
        super().__init__("camera", **options)
        declare_text(self, "source", _SOURCE, "virtual")
        declare_number(self, "rate", "Rate of a folder's pictures without times [1/s].", 10.0, 0.1, 120)
        declare_number(
            self, "speed", "Playback speed: 2 is twice as fast as filmed.", 1.0, 0.1, 20.0, read_only=True
        )
        declare_texts(self, "wait_for", "Nodes that must be active before recorded pictures are shown.")
        declare_text(self, "rig", "Rig file, for the virtual camera.")
        declare_text(self, "design", "Design file of the virtual robot.")
        declare_text(self, "lens", "Lens file of the camera, for camera_info. Default: the lens in a log.")
        self._compressed = self.advertise(
            "sensor_msgs/msg/CompressedImage", "camera/image_raw/compressed", ALL_PICTURES
        )
        self._raw = self.advertise("sensor_msgs/msg/Image", "camera/image_raw", RELIABLE)
        self._info = self.advertise("sensor_msgs/msg/CameraInfo", "camera/camera_info", RELIABLE)
        self._tags = self.advertise("std_msgs/msg/String", "camera/tags", LATCHED)
        self.listen("geometry_msgs/msg/PoseArray", "bench/masses", self._on_masses, NEWEST)
        self._rate = HeaderlessTopicDiagnostic(
            "pictures", self.diagnostics, FrequencyStatusParam({"min": 5.0, "max": 120.0})
        )
        self._frame = frame_name(self, pictures.FRAME_ID)
        self._virtual: RobotCamera | None = None
        self._lens: Lens | None = None
        self._size: tuple[int, int] | None = None
        self._playback: threading.Thread | None = None
        self._halt_event = threading.Event()

    def open(self) -> None:
        source, lens = get_value(self, "source"), find_file(self, "lens")
        if source == "virtual":
            self._virtual = RobotCamera.load(get_file(self, "rig"), get_file(self, "design"))
            self._tags.publish(new_message("std_msgs/msg/String", data=self._virtual.tags))
        elif not is_camera(source) and not Path(source).exists():
            raise EldirError(f"{source} does not exist", remedy="set the parameter source")
        if lens is not None:
            self._lens = Lens.load(lens)
        else:
            self._lens = load_recorded_lens(source) if self._virtual is None else self._virtual.lens

    def start(self) -> None:
        self._halt_event.clear()
        self._size = None
        if self._virtual is None:
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

    def _on_masses(self, message: Any) -> None:
        """Render the virtual robot at its new position."""
        if self._virtual is None or self.state != "active":
            return
        picture = self._virtual.render(marks.positions_from(message))
        self._publish(nanoseconds(message.header.stamp), jpeg.encode(picture).tobytes(), picture)

    def _play(self) -> None:
        """Publish the pictures of a source when they are due."""
        speed = get_value(self, "speed")
        while self.heartbeats.missing(tuple(get_value(self, "wait_for")), time.monotonic()):
            if self._halt_event.wait(0.1):
                return
        count, start, start_ns = 0, time.monotonic(), self.now_ns
        source = get_value(self, "source")
        try:
            for picture in timed_pictures(source, get_value(self, "rate")):
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
        self._compressed.publish(pictures.compressed_of(new_message, stamp, data, frame=self._frame))
        raw, info = (p.get_subscription_count() > 0 for p in (self._raw, self._info))
        if raw or (info and self._size is None):
            picture = jpeg.decode(np.frombuffer(data, np.uint8)) if picture is None else picture
            self._size = (picture.shape[1], picture.shape[0])
        if info and self._size is not None:
            self._info.publish(pictures.info_of(new_message, stamp, *self._size, self._lens, self._frame))
        if raw and picture is not None:
            self._raw.publish(pictures.raw_of(new_message, stamp, picture, self._frame))
        self._rate.tick()


def main() -> None:
    """`ros2 run eldir_ros camera`."""
    spin([CameraNode])
