# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Range of motion, live: the vertical range of each marker in a cycle, as simulated, predicted and tracked;
and the predicted robot, instant by instant."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from eldir_msgs.msg import RangeOfMotion, Run
from geometry_msgs.msg import PoseArray
from visualization_msgs.msg import MarkerArray

from eldir.design import Design
from eldir.errors import EldirError
from eldir_calibration.comparison.predictions import LivePrediction, LiveRangeOfMotion, predict_live
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule
from eldir_ros.base.frames import frame_name
from eldir_ros.base.logged_files import find_log, get_record, read_from
from eldir_ros.base.qualities import COMPLETE, LATCHED
from eldir_ros.base.rig_node import ACTIVE, RigNode
from eldir_ros.base.spinning import spin
from eldir_ros.conversions import marks, nanoseconds, runs
from eldir_ros.conversions.schedules import schedule_from

_CONTEXT = get_context("spawn")
_NICENESS = 10  # of the prediction: the run has priority


class RangeOfMotionNode(RigNode):
    """Publishes once a cycle, when all of the cycle was tracked."""

    def __init__(self, **options: Any):
        super().__init__("range_of_motion", **options)
        self._ranges = self.advertise(RangeOfMotion, "range_of_motion", LATCHED)
        self._masses = self.advertise(PoseArray, "predicted/masses", COMPLETE)
        self.listen(Run, "run", self._on_run, LATCHED)
        self.listen(MarkerArray, "marks", self._on_marks, COMPLETE)
        self._ground = frame_name(self, marks.FRAME_ID)
        self._replayed: ActuationSchedule | None = None
        """The schedule of the log that is replayed."""
        self._replayed_room_c: float | None = None
        """The air that was measured before the run that is replayed [C]."""
        self._design: Design | None = None
        self._run: LiveRangeOfMotion | None = None
        self._start_ns = 0
        # The engine compiles for seconds and blocks the other threads of its process meanwhile. A pool is
        # no choice: if a signal for all processes ends its worker, which holds a lock, it cannot be closed.
        self._prediction: Any = None

    def open(self) -> None:
        log = find_log(self, "log")
        self._rig = get_record(self, "rig", log, "rig.yaml", Rig)
        self._design = get_record(self, "design", log, "design.json", Design)
        self._replayed = None
        if log is not None:
            self._replayed = read_from(log, "schedule.json", ActuationSchedule)
            self._start_ns, self._replayed_room_c = log.log.epoch_ns, log.log.room_c

    def start(self) -> None:
        if self._replayed is not None:
            self._begin(self._replayed, self._start_ns, self._replayed_room_c)

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

    def _on_run(self, message: Run) -> None:
        if self.state != ACTIVE or self._replayed is not None:
            return
        if message.state != Run.RUNNING:
            if message.state != Run.FINISHED:  # of a finished one, the last markers are still on their way
                self._end()
            return
        room_c = runs.room_of(message)
        self._begin(schedule_from(message.schedule), nanoseconds(message.start), room_c)

    def _begin(self, schedule: ActuationSchedule, start_ns: int, room_c: float | None) -> None:
        if self._design is None:
            return
        self._start_ns = start_ns
        self._run = run = LiveRangeOfMotion(self._design, schedule)
        self._stop_prediction()
        receiver, sender = _CONTEXT.Pipe(duplex=False)
        process = _CONTEXT.Process(
            target=_predict, args=(sender, self._design, self._rig, schedule, room_c), daemon=True
        )
        process.start()
        self._prediction = process  # not before: a node that is shut down meanwhile could not end it
        sender.close()
        threading.Thread(target=self._await_predictions, args=(process, receiver, run), daemon=True).start()

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
        if isinstance(result, LivePrediction):
            run.prediction = result
        elif process is self._prediction is not None:  # it was not stopped on purpose
            self.report_fault(f"the prediction failed: {result}")

    def _on_marks(self, message: MarkerArray) -> None:
        run = self._run
        if run is None or self.state != ACTIVE or not message.markers:
            return
        stamp, names, positions = marks.tracks_from(message)
        t = 1e-9 * (stamp - self._start_ns)
        cycle = run.update(t, names, positions)
        masses = run.predicted_masses(t)
        if masses is not None:
            self._masses.publish(marks.poses_of(stamp, masses, self._ground))
        if cycle is not None:
            self._ranges.publish(runs.ranges_of(stamp, cycle.cycle, names, cycle.ranges, cycle.displacement))
            tracked = ", ".join(f"{1e3 * r:.1f}" for r in cycle.ranges["tracked"])
            self.get_logger().info(
                f"cycle {cycle.cycle}: tracked {tracked} mm, walked {cycle.displacement:+.2f} body lengths"
            )
            if run.prediction is None:
                self.get_logger().warning(
                    f"cycle {cycle.cycle} has no predicted ranges: the prediction, which is computed during "
                    "the run at a low priority, is not ready"
                )


def _predict(
    sender: Connection, design: Design, rig: Rig, schedule: ActuationSchedule, room_c: float | None
) -> None:
    """Send the predicted motions, or the error, from a separate process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches it too; the node ends it
    os.nice(_NICENESS)
    result: object
    try:
        result = predict_live(design, schedule, rig, room_c)
    except Exception as error:
        result = EldirError(str(error))
    with suppress(BrokenPipeError):  # the node has ended
        sender.send(result)


def main() -> None:
    """`ros2 run eldir_ros range_of_motion`."""
    spin([RangeOfMotionNode])
