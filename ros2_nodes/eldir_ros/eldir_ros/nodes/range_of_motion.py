# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Range of motion, live: the vertical range of each mark in a cycle, as simulated, predicted and tracked."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from eldir.design import Design
from eldir.errors import EldirError
from eldir_calibration.comparison.predictions import LiveRangeOfMotion, predict_motions
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule
from eldir_ros.base.interfaces import COMPLETE, LATCHED, declare_text, get_file, new_message
from eldir_ros.base.rig_node import RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import marks, nanoseconds, runs

_CONTEXT = get_context("spawn")
_NICENESS = 10  # of the prediction: the run has priority


class RangeOfMotionNode(RigNode):
    """Publishes once a cycle, when all of the cycle was tracked."""

    def __init__(self, **options: Any):
        super().__init__("range_of_motion", **options)
        declare_text(self, "rig", "Rig file (YAML, eldir-rig/1).")
        declare_text(self, "design", "Design file of the robot.")
        self._ranges = self.advertise("eldir_msgs/msg/RangeOfMotion", "range_of_motion", LATCHED)
        self.listen("eldir_msgs/msg/Run", "run", self._on_run, LATCHED)
        self.listen("visualization_msgs/msg/MarkerArray", "marks", self._on_marks, COMPLETE)
        self._design: Design | None = None
        self._run: LiveRangeOfMotion | None = None
        self._start_ns = 0
        # The engine compiles for seconds and blocks the other threads of its process meanwhile. A pool is
        # no choice: if a signal for all processes ends its worker, which holds a lock, it cannot be closed.
        self._prediction: Any = None

    def open(self) -> None:
        self._rig = Rig.load(get_file(self, "rig"))
        self._design = Design.load(get_file(self, "design"))

    def halt(self) -> None:
        self._end()

    def close(self) -> None:
        self._end()
        self._design = None

    def on_emergency_stop(self, reason: str) -> None:
        with self.transition:
            self._end()

    def shut_down(self) -> None:
        self._stop_prediction()
        super().shut_down()

    def _on_run(self, message: Any) -> None:
        if self.state != "active" or self._design is None:
            return
        if message.state != runs.RUNNING:
            if message.state != runs.RUN_FINISHED:  # of a finished one, the last marks are still on their way
                self._end()
            return
        schedule = runs.schedule_from(message.schedule)
        self._start_ns = nanoseconds(message.start)
        self._run = run = LiveRangeOfMotion(self._design, schedule)
        self._stop_prediction()
        receiver, sender = _CONTEXT.Pipe(duplex=False)
        self._prediction = _CONTEXT.Process(
            target=_predict, args=(sender, self._design, self._rig, schedule), daemon=True
        )
        self._prediction.start()
        sender.close()
        threading.Thread(
            target=self._await_predictions, args=(self._prediction, receiver, run), daemon=True
        ).start()

    def _end(self) -> None:
        """The run has ended early: cycles that are not played have no ranges."""
        self._run = None
        self._stop_prediction()

    def _stop_prediction(self) -> None:
        process, self._prediction = self._prediction, None
        if process is not None:
            process.kill()
            process.join()

    def _await_predictions(self, process: Any, receiver: Connection, run: LiveRangeOfMotion) -> None:
        with receiver:
            try:
                result = receiver.recv()
            except (EOFError, ConnectionError):
                result = EldirError("its process was ended")
        if isinstance(result, dict):
            run.predictions.update(result)
        elif process is self._prediction is not None:  # it was not stopped on purpose
            self.report_fault(f"the prediction failed: {result}")

    def _on_marks(self, message: Any) -> None:
        run = self._run
        if run is None or self.state != "active" or not message.markers:
            return
        stamp, names, positions = marks.tracks_from(message)
        cycle = run.update(1e-9 * (stamp - self._start_ns), names, positions)
        if cycle is not None:
            self._ranges.publish(
                runs.ranges_of(new_message, stamp, cycle.cycle, names, cycle.ranges, cycle.displacement)
            )
            tracked = ", ".join(f"{1e3 * r:.1f}" for r in cycle.ranges["tracked"])
            self.get_logger().info(
                f"cycle {cycle.cycle}: tracked {tracked} mm, walked {cycle.displacement:+.2f} body lengths"
            )


def _predict(sender: Connection, design: Design, rig: Rig, schedule: ActuationSchedule) -> None:
    """Send the predicted motions, or the error, from a separate process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches it too; the node ends it
    os.nice(_NICENESS)
    result: object
    try:
        result = predict_motions(design, schedule, rig)
    except Exception as error:
        result = EldirError(str(error))
    with suppress(BrokenPipeError):  # the node has ended
        sender.send(result)


def main() -> None:
    """`ros2 run eldir_ros range_of_motion`."""
    spin([RangeOfMotionNode])
