"""The camera: pictures from any source of the toolkit, or of the virtual rig's robot."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from diagnostic_updater import FrequencyStatusParam, HeaderlessTopicDiagnostic
from numpy.typing import NDArray

from calibration.camera.lens import Lens
from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir_ros import parameters
from eldir_ros.conversions import marks, nanoseconds, pictures
from eldir_ros.messages import LATCHED, PICTURES, RELIABLE, class_of, make
from eldir_ros.process import spin
from eldir_ros.rig_node import RigNode
from hardware.images import jpeg
from hardware.rig.camera_name import is_camera


class Picture(NamedTuple):
    """One frame, to be shown when it is due."""

    due: float
    """Seconds since the first."""
    stamp: int | None
    """[ns], as recorded; None for the moment at which it is shown."""
    data: bytes
    """JPEG."""


class Camera(RigNode):
    """Publishes image_raw, its compressed form, and camera_info."""

    def __init__(self, **options: Any):
        super().__init__("camera", **options)
        parameters.text(
            self,
            "source",
            "A camera such as camera:0 or /dev/video0, a video, a folder of pictures, a log; or: virtual.",
            "virtual",
        )
        parameters.number(self, "rate", "Of a folder's pictures, which carry no times [1/s].", 10.0, 0.1, 120)
        parameters.number(self, "speed", "Times as fast as it was filmed.", 1.0, 0.1, 20.0, fixed=True)
        parameters.texts(self, "wait_for", "Nodes that must be active before recorded pictures are shown.")
        parameters.text(self, "rig", "Rig file, for the virtual camera.")
        parameters.text(self, "design", "Design file of the virtual robot.")
        parameters.text(self, "lens", "Lens file of the camera, told as camera_info; a log brings its own.")
        self._compressed = self.create_publisher(
            class_of("sensor_msgs/msg/CompressedImage"), "camera/image_raw/compressed", RELIABLE
        )
        self._raw = self.create_publisher(class_of("sensor_msgs/msg/Image"), "camera/image_raw", RELIABLE)
        self._info = self.create_publisher(
            class_of("sensor_msgs/msg/CameraInfo"), "camera/camera_info", RELIABLE
        )
        self._tags = self.create_publisher(class_of("std_msgs/msg/String"), "camera/tags", LATCHED)
        self.create_subscription(
            class_of("geometry_msgs/msg/PoseArray"), "bench/masses", self._on_masses, PICTURES
        )
        self._rate = HeaderlessTopicDiagnostic(
            "pictures", self.diagnostics, FrequencyStatusParam({"min": 5.0, "max": 120.0})
        )
        self._virtual: _VirtualCamera | None = None
        self._lens: Lens | None = None
        self._size: tuple[int, int] | None = None
        self._showing: threading.Thread | None = None
        self._enough = threading.Event()

    def open(self) -> None:
        source = parameters.value(self, "source")
        if source == "virtual":
            self._virtual = _VirtualCamera(
                parameters.path(self, "rig"),  # type: ignore[arg-type]
                parameters.path(self, "design"),  # type: ignore[arg-type]
            )
            self._tags.publish(make("std_msgs/msg/String", data=self._virtual.tags))
        elif not is_camera(source) and not Path(source).exists():
            raise EldirError(f"{source} does not exist", remedy="set the parameter source")
        self._lens = lens_of(parameters.path(self, "lens", needed=False), source)

    def start(self) -> None:
        self._enough.clear()
        self._size = None
        if self._virtual is None:
            self._showing = threading.Thread(target=self._show_all, name="pictures", daemon=True)
            self._showing.start()

    def rest(self) -> None:
        self._enough.set()
        if self._showing is not None:
            self._showing.join()
            self._showing = None

    def close(self) -> None:
        self.rest()
        self._virtual = None

    def _on_masses(self, message: Any) -> None:
        """Where the virtual robot is: filmed at once."""
        if self._virtual is None or self.state != "active":
            return
        picture = self._virtual.render(marks.places_from(message))
        try:
            self._show(nanoseconds(message.header.stamp), jpeg.encode(picture).tobytes(), picture)
        except EldirError as error:
            self.trouble(str(error))

    def _show_all(self) -> None:
        """The pictures of a source, at their pace."""
        speed = parameters.value(self, "speed")
        while self.beats.missing(tuple(parameters.value(self, "wait_for")), time.monotonic()):
            if self._enough.wait(0.1):
                return
        count, begun, begun_ns = 0, time.monotonic(), self.now_ns
        source = parameters.value(self, "source")
        try:
            for picture in pictures_of(source, parameters.value(self, "rate")):
                if count == 0:  # a camera takes a while to open
                    begun, begun_ns = time.monotonic(), self.now_ns
                if self._enough.wait(max(begun + picture.due / speed - time.monotonic(), 0.0)):
                    return
                due_ns = begun_ns + round(1e9 * picture.due / speed)
                self._show(due_ns if picture.stamp is None else picture.stamp, picture.data, None)
                count += 1
        except EldirError as error:
            self.trouble(str(error))
            return
        self.get_logger().info(f"{source}: all {count} pictures shown")

    def _show(self, stamp: int, data: bytes, picture: NDArray[np.uint8] | None) -> None:
        self._compressed.publish(pictures.compressed_of(make, stamp, data))
        raw, info = (p.get_subscription_count() > 0 for p in (self._raw, self._info))
        if raw or (info and self._size is None):
            picture = jpeg.decode(np.frombuffer(data, np.uint8)) if picture is None else picture
            self._size = (picture.shape[1], picture.shape[0])
        if info and self._size is not None:
            self._info.publish(pictures.info_of(make, stamp, *self._size, self._lens))
        if raw and picture is not None:
            self._raw.publish(pictures.raw_of(make, stamp, picture))
        self._rate.tick()


def pictures_of(source: str, rate: float) -> Iterator[Picture]:
    """The pictures of a camera, a file or a folder; those of a log exactly as recorded."""
    from hardware.vision.sources import Log, open_source

    opened = open_source(source, rate, seconds=float("inf"))
    first: float | None = None
    if isinstance(opened, Log):
        for stamp, data in opened.log.pictures:
            first = 1e-9 * stamp if first is None else first
            yield Picture(1e-9 * stamp - first, stamp, data.tobytes())
        return
    for t, image in opened:
        first = t if first is None else first
        yield Picture(t - first, None, jpeg.encode(image).tobytes())


def lens_of(file: Path | None, source: str) -> Lens | None:
    """The lens in a file, or that of the log from which the pictures come."""
    from hardware.vision.attachments import lens_that_came_with
    from hardware.vision.sources import Log, open_source

    if file is not None:
        return Lens.load(file)
    if source == "virtual" or is_camera(source):
        return None
    opened = open_source(source)
    return lens_that_came_with(opened) if isinstance(opened, Log) else None


class _VirtualCamera:
    """The rig file's virtual camera before the design's robot, with the tags that stand around it."""

    def __init__(self, rig_path: Path, design_path: Path):
        from calibration.camera.plane import FieldOfView
        from eldir.built.robot import build
        from eldir.design import Design
        from hardware.rig.configuration import CameraEntry, Rig
        from hardware.vision.virtual_camera import VirtualCamera

        rig = Rig.load(rig_path)
        design = Design.load(design_path)
        entry = rig.camera or CameraEntry(kind="virtual")
        self._springs, self._marked = design.morphology.springs, design.marks
        self._camera = VirtualCamera(
            rig.virtual.seed,
            FieldOfView.around(build(design.morphology).positions),
            size=(entry.width, entry.height),
            rate=entry.rate_hz,
        )
        self.tags = json.dumps(self._camera.board.to_json())

    def render(self, positions: FloatArray) -> NDArray[np.uint8]:
        """BGR picture of all masses at `positions` (M, 2) [m]."""
        return self._camera.render(positions, self._springs, self._marked)


def main() -> None:
    """`ros2 run eldir_ros camera`."""
    spin([Camera])
