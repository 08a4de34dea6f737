"""Range of motion, live: how far each mark goes up and down in a cycle, as evolved, predicted and seen."""

from __future__ import annotations

import signal
from multiprocessing import get_context
from typing import Any

import numpy as np

from calibration.report.comparison import Motion
from eldir.built.robot import build
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.errors import EldirError
from eldir.trajectory import Trajectory
from eldir_ros.base import node_parameters
from eldir_ros.base.message_types import COMPLETE, LATCHED, message_class, new_message
from eldir_ros.base.rig_node import RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import marks, nanoseconds, runs
from hardware.rig.configuration import Rig
from hardware.schedule import ActuationSchedule


class RangeOfMotionNode(RigNode):
    """Publishes once a cycle, when the camera has seen it whole."""

    def __init__(self, **options: Any):
        super().__init__("range_of_motion", **options)
        node_parameters.declare_text(self, "rig", "Rig file (YAML, eldir-rig/1).")
        node_parameters.declare_text(self, "design", "Design file of the robot.")
        self._ranges = self.create_publisher(
            message_class("control_msgs/msg/DynamicJointState"), "range_of_motion", LATCHED
        )
        self.create_subscription(message_class("eldir_msgs/msg/Run"), "run", self._on_run, LATCHED)
        self.create_subscription(
            message_class("visualization_msgs/msg/MarkerArray"), "marks", self._on_marks, COMPLETE
        )
        self._design: Design | None = None
        self._run: _Watched | None = None
        # The engine compiles for seconds and lets no other thread run meanwhile: it has its own process.
        self._aside = get_context("spawn").Pool(1, signal.signal, (signal.SIGINT, signal.SIG_IGN))

    def open(self) -> None:
        self._rig = Rig.load(node_parameters.get_path(self, "rig"))  # type: ignore[arg-type]
        self._design = Design.load(node_parameters.get_path(self, "design"))  # type: ignore[arg-type]

    def rest(self) -> None:
        self._run = None

    def close(self) -> None:
        self._run = self._design = None

    def leave(self) -> None:
        self._aside.terminate()
        super().leave()

    def _on_run(self, message: Any) -> None:
        if self.state != "active" or message.state != runs.RUNNING or self._design is None:
            return
        schedule = runs.schedule_from(message.schedule)
        self._run = run = _Watched(self._design, schedule, nanoseconds(message.start))
        self._aside.apply_async(
            _compute,
            (self._design, self._rig, schedule),
            callback=run.without_camera.update,
            error_callback=lambda error: self.trouble(f"the prediction failed: {error}"),
        )

    def _on_marks(self, message: Any) -> None:
        run = self._run
        if run is None or self.state != "active" or not message.markers:
            return
        stamp, names, places = marks.tracks_from(message)
        if run.see(stamp, places) and (found := run.latest(names)) is not None:
            ranges, walked = found
            self._ranges.publish(runs.ranges_of(new_message, stamp, names, ranges, walked))
            tracked = 1e3 * ranges["tracked"]
            self.get_logger().info(
                f"cycle {run.cycle}: tracked {', '.join(f'{r:.1f}' for r in tracked)} mm, "
                f"walked {walked['tracked']:+.2f} body lengths"
            )


class _Watched:
    """A run as it goes on; the two motions that need no camera are computed meanwhile."""

    def __init__(
        self,
        design: Design,
        schedule: ActuationSchedule,
        start: int,
    ):
        self._length = build(design.morphology).body_length
        self._schedule, self._start = schedule, start
        self._times: list[float] = []
        self._places: list[FloatArray] = []
        self.cycle = 0
        """How many cycles that count have been seen whole."""
        self.without_camera: dict[str, Motion] = {}
        """The evolved and the predicted motion, once they are computed."""

    def see(self, stamp: int, places: FloatArray) -> bool:
        """Add where the marks are; whether another cycle has passed."""
        t = 1e-9 * (stamp - self._start)
        if t < 0 or (self._times and t <= self._times[-1]):
            return False
        self._times.append(t)
        self._places.append(places)
        whole = int((t - self._schedule.start_of_cycles) / self._schedule.period_s)
        passed = min(whole, self._schedule.cycles) > self.cycle
        self.cycle = max(self.cycle, min(whole, self._schedule.cycles))
        return passed

    def latest(self, names: tuple[str, ...]) -> tuple[dict[str, FloatArray], dict[str, float]] | None:
        """Vertical ranges [m] of each kind and mark, and the walk [body lengths], in the latest cycle."""
        begin = self._schedule.start_of_cycles + (self.cycle - 1) * self._schedule.period_s
        places = np.array(self._places)
        trajectory = Trajectory(names, np.array(self._times), places)
        length = self._length
        try:
            tracked = Motion(trajectory, begin, self._schedule.period_s, 1, length)
            motions = {**self.without_camera, "tracked": tracked}
            # Of the evolved motion, which has no cycles in common with the schedule, the last one counts.
            ranges = {
                kind: m.vertical_ranges()[-1 if kind == "simulated" else min(self.cycle, m.cycles) - 1]
                for kind, m in motions.items()
            }
            walked = {"tracked": tracked.displacement() / 5.0}
        except EldirError:  # a mark that was hardly seen
            return None
        return ranges, walked


def _compute(design: Design, rig: Rig, schedule: ActuationSchedule) -> dict[str, Motion]:
    """What needs no camera, in a process of its own."""
    from hardware.analysis.predictions import motions_without_camera

    return dict(zip(("simulated", "predicted"), motions_without_camera(design, schedule, rig), strict=True))


def main() -> None:
    """`ros2 run eldir_ros range_of_motion`."""
    spin([RangeOfMotionNode])
