"""Writes the log of a run: frames, tracks, relays, temperatures, and the files of the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eldir.core.records import FloatArray
from eldir_hardware.camera.lens import Lens
from eldir_hardware.images import jpeg
from eldir_hardware.log import messages as m
from eldir_hardware.log._growing import GrowingLog
from eldir_hardware.markers.registration import DISC_DIAMETER, PALETTE

_WARN, _OK = 1, 0  # levels of diagnostic_msgs


class Recorder(GrowingLog):
    """A log that grows while a run goes on, between `open` and `close` or in a `with`.

    Times are seconds from the start of the run. A killed program loses at most the last
    second. A run that fails leaves a valid log up to the failure.
    """

    def __init__(
        self,
        path: Path | str,
        channels: Sequence[str] = (),
        springs: Sequence[str] = (),
        epoch_ns: int | None = 0,
        lens: Lens | None = None,
        facts: Mapping[str, str] | None = None,
    ):
        """`channels` and `springs` name what `on_relays` and `on_temperatures` report, in order;
        `epoch_ns` and `facts` as in `GrowingLog`;
        `lens`: of the camera; it is attached to the log and written as CameraInfo."""
        super().__init__(path, epoch_ns, facts)
        self._channels, self._springs = tuple(channels), tuple(springs)
        self._lens = lens

    def open(self) -> None:
        super().open()
        if self._lens is not None:
            self.attach("camera.json", self._lens)

    def on_frame(self, t: float, bgr: NDArray[np.uint8]) -> None:
        """A picture (H, W, 3) of the camera."""
        self.on_picture(t, jpeg.encode(bgr), bgr.shape[1], bgr.shape[0])

    def on_picture(self, t: float, data: NDArray[np.uint8], width: int, height: int) -> None:
        """A picture of the camera that is JPEG already, bytes (N,)."""
        if m.CAMERA_INFO not in self._channel_ids:
            if self._lens is not None:
                self._lens.require_size(width, height)
            self.on_camera_info(t, m.camera_info_fields(self._lens, width, height))
        image = m.make_message("image", header=self._header(t, m.CAMERA_FRAME_ID), format="jpeg", data=data)
        self._write(m.IMAGE, "image", t, image)

    def on_camera_info(self, t: float, info: Mapping[str, Any]) -> None:
        """The lens as the camera's driver reports it: the fields of sensor_msgs/CameraInfo by name, without
        header. If there is none before the first picture, the lens file is used."""
        region = m.make_ros_message("sensor_msgs/msg/RegionOfInterest", **info["roi"])
        fields = dict(info) | {"header": self._header(t, m.CAMERA_FRAME_ID), "roi": region}
        self._write(m.CAMERA_INFO, "camera_info", t, m.make_message("camera_info", **fields))

    def on_tracks(self, t: float, names: Sequence[str], positions: FloatArray) -> None:
        """Positions of the markers in the plane (K, 2) [m]; NaN if not detected."""
        header = self._header(t, m.FRAME_ID)
        markers = []
        for number, (name, (x, y)) in enumerate(
            zip(names, np.asarray(positions, float).tolist(), strict=True)
        ):
            markers.append(_marker(header, number, name, x, y))
            if np.isfinite(x):
                point = m.make_ros_message("geometry_msgs/msg/Point", x=x, y=0.0, z=y)
                self._write(
                    m.marker_topic(name), "point", t, m.make_message("point", header=header, point=point)
                )
        self._write(m.MARKERS, "markers", t, m.make_message("markers", markers=markers))

    def on_relays(self, t: float, states: Sequence[bool]) -> None:
        """The board's report of its contacts: 1 is closed."""
        names = self._channels or tuple(f"contact{i}" for i in range(len(states)))
        self._write_values(m.RELAYS, m.CLOSED, t, names, states)
        self._flush()

    def on_temperatures(self, t: float, celsius: Sequence[float]) -> None:
        """Temperature of every spring [C]."""
        names = self._springs or tuple(f"spring{i}" for i in range(len(celsius)))
        for name, value in zip(names, celsius, strict=True):
            reading = m.make_message(
                "temperature", header=self._header(t), temperature=float(value), variance=0.0
            )
            self._write(m.spring_topic(name), "temperature", t, reading)

    def on_currents(self, t: float, amperes: Sequence[float], volts: Sequence[float]) -> None:
        """Measured current [A] and voltage [V] of every spring; NaN where it is not measured."""
        names = self._springs or tuple(f"spring{i}" for i in range(len(amperes)))
        self._write_values(m.CURRENTS, m.CURRENT, t, names, amperes)
        self._write_values(m.VOLTAGES, m.VOLTAGE, t, names, volts)

    def on_status(
        self, t: float, name: str, message: str, values: Mapping[str, object] | None = None, good: bool = True
    ) -> None:
        """An event of a part of the rig, such as why it stopped."""
        pairs = [
            m.make_ros_message("diagnostic_msgs/msg/KeyValue", key=k, value=str(v))
            for k, v in (values or {}).items()
        ]
        status = m.make_ros_message(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=_OK if good else _WARN,
            name=name,
            message=message,
            hardware_id="",
            values=pairs,
        )
        self._write(m.STATUS, "status", t, m.make_message("status", header=self._header(t), status=[status]))
        self._flush()

    def on_event(self, t: float, text: str) -> None:
        """An event of the player, such as a pause."""
        self.on_status(t, "player", text)

    def on_stall(self, t: float, seconds: float) -> None:
        """The camera gave no picture for `seconds` [s]."""
        self.on_status(t, "camera", f"no frame for {seconds:.1f} s", good=False)

    def _write_values(
        self, topic: str, interface: str, t: float, names: Sequence[str], values: Sequence[float]
    ) -> None:
        """One number for each name."""
        self._write(topic, "values", t, m.make_values(self._to_ns(t), names, interface, values))

    def _header(self, t: float, frame_id: str = "") -> Any:
        return m.make_header(self._to_ns(t), frame_id)


def _marker(header: Any, number: int, name: str, x: float, y: float) -> Any:
    """A marker as RViz and Foxglove draw it; deleted if it was not detected."""
    is_detected = bool(np.isfinite(x))
    red, green, blue = (c / 255 for c in PALETTE.get(name, (128, 128, 128)))
    zero = m.make_ros_message("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
    place = m.make_ros_message(
        "geometry_msgs/msg/Point", x=x if is_detected else 0.0, y=0.0, z=y if is_detected else 0.0
    )
    upright = m.make_ros_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    kind: Any = m.typestore().types["visualization_msgs/msg/Marker"]
    no_picture = m.make_message("image", header=header, format="", data=np.zeros(0, np.uint8))
    no_mesh = m.make_ros_message("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8))
    return kind(
        header=header,
        ns=name,
        id=number,
        type=kind.SPHERE,
        action=kind.ADD if is_detected else kind.DELETE,
        pose=m.make_ros_message("geometry_msgs/msg/Pose", position=place, orientation=upright),
        scale=m.make_ros_message(
            "geometry_msgs/msg/Vector3", x=DISC_DIAMETER, y=DISC_DIAMETER, z=DISC_DIAMETER
        ),
        color=m.make_ros_message("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        lifetime=zero,
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=no_picture,
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=no_mesh,
        mesh_use_embedded_materials=False,
    )
