"""Range of motion cycle by cycle, while the markers of a run are still arriving."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from eldir.built.gait import CYCLES
from eldir.built.robot import build
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.errors import EldirError
from eldir.trajectory import Trajectory
from eldir_calibration.report.comparison import Motion
from eldir_hardware.schedule import ActuationSchedule


class CycleRanges(NamedTuple):
    """Ranges of motion and displacement in one cycle of a run."""

    cycle: int
    """Number of the cycle, from 1."""
    ranges: dict[str, FloatArray]
    """Vertical range of motion [m] of each marker (K,), by kind: `tracked`, and `simulated` and `predicted`
    as soon as they are known."""
    displacement: float
    """Tracked displacement in the cycle [body lengths]."""


class LiveRangeOfMotion:
    """Ranges of motion of one run, from the markers as they arrive."""

    def __init__(self, design: Design, schedule: ActuationSchedule):
        self.predictions: dict[str, Motion] = {}
        """The motions without a camera, by kind; set it to the result of `predict_motions`."""
        self._body_length = build(design.morphology).body_length
        self._schedule = schedule
        self._times: list[float] = []
        self._positions: list[FloatArray] = []
        self._cycle = 0

    def update(self, t: float, names: tuple[str, ...], positions: FloatArray) -> CycleRanges | None:
        """Add the positions (K, 2) [m] of the markers at `t` [s since the schedule's start].

        Returns the ranges of the latest cycle when `t` is the first time after its end, else None; also
        None where the positions do not cover the cycle. A marker that was not seen has the range NaN. Times
        before the start and out of order are ignored.
        """
        if t < 0 or (self._times and t <= self._times[-1]):
            return None
        self._times.append(t)
        self._positions.append(positions)
        whole = int((t - self._schedule.start_of_cycles) / self._schedule.period_s)
        complete = min(whole, self._schedule.cycles)
        if complete <= self._cycle:
            return None
        self._cycle = complete
        return self._latest(names)

    def _latest(self, names: tuple[str, ...]) -> CycleRanges | None:
        begin = self._schedule.start_of_cycles + (self._cycle - 1) * self._schedule.period_s
        trajectory = Trajectory(names, np.array(self._times), np.array(self._positions))
        try:
            tracked = Motion(trajectory, begin, self._schedule.period_s, 1, self._body_length)
            # The simulated motion has other cycles than the schedule: its last one counts.
            ranges = {
                kind: motion.vertical_ranges()[
                    -1 if kind == "simulated" else min(self._cycle, motion.cycles) - 1
                ]
                for kind, motion in {**self.predictions, "tracked": tracked}.items()
            }
            return CycleRanges(self._cycle, ranges, tracked.displacement() / CYCLES)
        except EldirError:  # the positions do not cover the cycle
            return None
