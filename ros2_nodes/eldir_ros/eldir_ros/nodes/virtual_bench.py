# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The virtual rig's hardware: an emulated board on a port, springs, and a robot.

It replaces hardware, not software, of the rig: it has no lifecycle and ignores the emergency stop.
"""

from __future__ import annotations

import json
import time
from contextlib import ExitStack, suppress
from typing import Any

from geometry_msgs.msg import PoseArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from eldir.built.ground import lay_on_table
from eldir.design import Design
from eldir.errors import EldirError
from eldir_hardware.realtime import VIRTUAL_BENCH, request_realtime_priority
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import VirtualCameraEntry
from eldir_hardware.safety.latch import unlatch
from eldir_hardware.virtual.bodies import BodyProcess, find_parameters
from eldir_hardware.virtual.rig import BodyFrame, VirtualRig
from eldir_ros.base.frames import frame_name
from eldir_ros.base.parameters import declare_parameters, find_file, get_file
from eldir_ros.base.qualities import RELIABLE
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import marks

_MIN_SHUTDOWN, _MAX_SHUTDOWN = 1.5, 4.0  # time for guardians to open contacts at the end [s]


class VirtualBenchNode(Node):
    """Publishes the true positions of the robot's masses, and of its discs where it may leave its plane, at
    the virtual camera's rate."""

    def __init__(self, **options: Any):
        super().__init__("virtual_bench", **options)
        declare_parameters(self, "virtual_bench")
        self._masses = self.create_publisher(PoseArray, "bench/masses", RELIABLE)
        self._discs = self.create_publisher(PoseArray, "bench/discs", RELIABLE)
        self._ground = frame_name(self, marks.FRAME_ID)
        self._edges_written = 0
        self._opened = ExitStack()
        with ExitStack() as opening:
            rate = self._power_on(opening)
            self._opened = opening.pop_all()
        # Threads that are started later get it too: the emulated board waits for Python's lock, and a thread
        # that holds it must not wait for a processor. The robot's process was started before, and has none.
        request_realtime_priority(VIRTUAL_BENCH)
        self._rig.start = self._rig.clock.now()
        self._rig.watch(rate, self._publish)
        self.create_timer(0.05, self._write_edges, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _power_on(self, opened: ExitStack) -> float:
        """Start the emulated hardware; returns the camera's rate [1/s]."""
        rig = Rig.load(get_file(self, "rig"))
        rig = rig.model_copy(update={"virtual": rig.virtual.model_copy(update={"clock": "wall"})})
        design = Design.load(get_file(self, "design"))
        rig.require_motors(design.morphology.motors)
        trace, link = find_file(self, "trace"), find_file(self, "port")
        self._trace = None if trace is None else opened.enter_context(trace.open("w", buffering=1))
        virtual, (printed, springs) = rig.virtual, find_parameters(rig)
        body = opened.enter_context(
            BodyProcess(
                virtual.physics,
                design.morphology,
                virtual.seed,
                springs,
                design.ballast,
                printed,
                terrain=lay_on_table(design),
                dimensions=virtual.dimensions,
            )
        )
        self._body, self._logged_remark = body, ""
        self._rig = opened.enter_context(VirtualRig(rig, body, springs))
        port = self._rig.emulator.port
        if link is not None:
            link.unlink(missing_ok=True)
            link.symlink_to(port)
            opened.callback(link.unlink, missing_ok=True)
        unlatch(str(link or port))  # the board behind this link before was another one
        self.get_logger().info(f"emulated {rig.board.kind} board on {link or port}")
        return (rig.camera or VirtualCameraEntry(kind="virtual")).rate_hz

    def _publish(self, frame: BodyFrame) -> None:
        late = self._rig.clock.now() - (frame.time_s + self._rig.start)
        stamp = int(self.get_clock().now().nanoseconds) - round(1e9 * late)
        with suppress(Exception):  # the context may just have been shut down
            self._masses.publish(marks.poses_of(stamp, frame.positions, self._ground))
            if frame.discs is not None:
                self._discs.publish(marks.discs_of(stamp, frame.discs, self._ground))
            if (remark := self._body.remark) != self._logged_remark:
                self._logged_remark = remark
                self.get_logger().warning(remark)

    def _write_edges(self) -> None:
        edges = self._rig.emulator.contact_events
        while self._trace is not None and self._edges_written < len(edges):
            edge = edges[self._edges_written]
            self._trace.write(
                json.dumps({"t_s": edge.t, "channel": edge.channel, "closed": edge.closed}) + "\n"
            )
            self._edges_written += 1

    def shut_down(self) -> None:
        """Switch the emulated hardware off, but give guardians a moment to open the contacts first."""
        ended = time.monotonic()
        while (passed := time.monotonic() - ended) < _MIN_SHUTDOWN or (
            passed < _MAX_SHUTDOWN and any(self._rig.emulator.contacts)
        ):
            time.sleep(0.05)
        self._write_edges()
        self._trace = None
        with suppress(EldirError):
            self._opened.close()


def main() -> None:
    """`ros2 run eldir_ros virtual_bench`."""
    spin([VirtualBenchNode])
