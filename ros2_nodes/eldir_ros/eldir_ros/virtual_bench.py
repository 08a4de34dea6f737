"""The virtual rig's hardware: an emulated board on a port, springs, and a robot; not a part of the rig's
software, so it has no lifecycle and obeys nobody."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.node import Node

from eldir.errors import EldirError, InputError
from eldir_ros import parameters
from eldir_ros.body_aside import BodyAside
from eldir_ros.conversions import marks
from eldir_ros.messages import RELIABLE, class_of, make
from eldir_ros.process import spin
from hardware.rig.configuration import Rig
from hardware.rig.sections import VirtualCameraEntry
from hardware.safety.latch import unlatch
from hardware.virtual.rig import BodyFrame, VirtualRig

_LEAST, _MOST = 1.5, 4.0  # at the end guardians may still open contacts, at least and at most for so long [s]


class VirtualBench(Node):
    """Publishes where the robot's masses truly are, at the virtual camera's rate."""

    def __init__(self, **options: Any):
        super().__init__("virtual_bench", **options)
        parameters.text(self, "rig", "Rig file of kind virtual.")
        parameters.text(self, "design", "Design file of the robot.")
        parameters.text(self, "port", "Link to make to the emulated board's port.")
        parameters.text(self, "trace", "File for the contacts' edges (JSON lines), as `eldir rig emulate`.")
        self._masses = self.create_publisher(
            class_of("geometry_msgs/msg/PoseArray"), "bench/masses", RELIABLE
        )
        self._traced = 0
        self._rig, rig, self._trace = self._power_on()
        self._rig.start = self._rig.clock.now()
        self._rig.watch((rig.camera or VirtualCameraEntry(kind="virtual")).rate_hz, self._show)
        self.create_timer(0.05, self._write_edges)

    def _power_on(self) -> tuple[VirtualRig, Rig, Any]:
        from eldir.design import Design

        rig = Rig.load(parameters.path(self, "rig"))  # type: ignore[arg-type]
        rig = rig.model_copy(update={"virtual": rig.virtual.model_copy(update={"clock": "wall"})})
        design_path = parameters.path(self, "design")
        design = Design.load(design_path)  # type: ignore[arg-type]
        if design.morphology.motors > rig.motors:
            raise InputError(
                "the rig has too few springs for this design",
                expected=str(design.morphology.motors),
                found=str(rig.motors),
            )
        self._body = BodyAside(design_path, rig.virtual.seed, rig.spring_parameters())  # type: ignore[arg-type]
        virtual = VirtualRig(rig, self._body)
        virtual.open()
        port = virtual.emulator.port
        unlatch(port)  # another board may have had this pseudo-terminal before
        link = parameters.path(self, "port", needed=False)
        if link is not None:
            link.unlink(missing_ok=True)
            link.symlink_to(port)
        trace = parameters.path(self, "trace", needed=False)
        self.get_logger().info(f"emulated {rig.board.kind} board on {link or port}")
        return virtual, rig, None if trace is None else trace.open("w", buffering=1)

    def _show(self, frame: BodyFrame) -> None:
        late = self._rig.clock.now() - (frame.time_s + self._rig.start)
        stamp = int(self.get_clock().now().nanoseconds) - round(1e9 * late)
        with suppress(Exception):  # the context may just have been shut down
            self._masses.publish(marks.poses_of(make, stamp, frame.positions))

    def _write_edges(self) -> None:
        edges = self._rig.emulator.edges
        while self._trace is not None and self._traced < len(edges):
            edge = edges[self._traced]
            self._trace.write(
                json.dumps({"t_s": edge.t, "channel": edge.channel, "closed": edge.closed}) + "\n"
            )
            self._traced += 1

    def leave(self) -> None:
        """Hardware outlives the programs that drive it, if only for a moment."""
        ended = time.monotonic()
        while (passed := time.monotonic() - ended) < _LEAST or (
            passed < _MOST and any(self._rig.emulator.contacts)
        ):
            time.sleep(0.05)
        self._write_edges()
        with suppress(EldirError):
            self._rig.close()
        self._body.close()
        link = parameters.path(self, "port", needed=False)
        if link is not None:
            Path(link).unlink(missing_ok=True)
        if self._trace is not None:
            self._trace.close()


def main() -> None:
    """`ros2 run eldir_ros virtual_bench`."""
    spin([VirtualBench])
