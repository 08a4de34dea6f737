"""One filmed run as identification takes it: the tracked marks, when each motor was heated, and whether the
robot stayed upright."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldir.built.heat import SpringState, heat
from eldir.built.motion import BuiltMotion, drive
from eldir.built.robot import build
from eldir.built.walking import TOPPLED
from eldir.core.records import FloatArray, IntArray, Record
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.trajectory import Trajectory

INTERVAL = 0.05
"""Time between the instants at which free lengths are given [s]."""
_LAY = 30  # intervals for which a robot has lain there, its cold springs pulling, before the film begins
_LEAST_MARKS = 3  # marks that determine the rotation of the body; two do not
_LONG_LYING = 1.0  # a robot turned for this time in all lies; less may be a mistaken mark [s]


@dataclass(frozen=True, eq=False)
class FilmedBody(Record):
    """The robot that was filmed: its body, and which masses carry marks."""

    morphology: Morphology
    marks: IntArray
    """Mass indices of the marks, shape (K,)."""
    ballast: FloatArray | float = 0.0
    """Ballast on this plane, as `eldir.built.robot.build` takes it [kg]."""


@dataclass(frozen=True, eq=False)
class Recording(Record):
    """One run of a robot, from rest and cold."""

    tracked: Trajectory
    """The marks; NaN where they were not seen."""
    on: FloatArray
    """Fraction of each interval in which each motor's contact was closed, shape (steps, A)."""
    start: float
    """When the first cycle that counts begins [s]."""
    period: float
    """Duration of a cycle [s]."""
    cycles: int

    def until(self, end: float) -> Recording:
        """The part of the recording before `end` [s]."""
        t = self.tracked.times
        kept = t <= end + 1e-9
        return Recording(
            Trajectory(self.tracked.names, t[kept], self.tracked.positions[kept]),
            self.on[: int(np.ceil(end / INTERVAL - 1e-9)) + 1],
            self.start,
            self.period,
            max(0, int((end - self.start) / self.period + 1e-6)),
        )

    @property
    def end(self) -> float:
        """End of the last cycle [s]."""
        return self.start + self.period * self.cycles

    @property
    def within(self) -> FloatArray:
        """Instants of the frames that the model can be asked about [s]."""
        return np.clip(self.tracked.times, 0.0, len(self.on) * INTERVAL)


def predict_marks(
    body: FilmedBody, recordings: Sequence[Recording], robots: Sequence[RobotParameters]
) -> list[FloatArray]:
    """Motions of the marks of different robots of one body under each recording's heating, at its frames.

    One array (robots, frames, marks, 2) [m] for each recording; NaN from where a robot blew up. All
    run side by side in the engine's vector lanes.
    """
    built = [build(body.morphology, robot, ballast=body.ballast) for robot in robots]
    springs = [robot.springs_of(body.morphology.motors) for robot in robots]
    free = [robot.free_lengths for robot in robots]
    tables = [table for r in recordings for table in _lengths(r.on, springs)]
    runs = len(recordings)
    motions = drive(built * runs, tables, INTERVAL, free=free * runs)
    return [
        np.stack([_at(m, body.marks, r.within) for m in motions[k * len(robots) : (k + 1) * len(robots)]])
        for k, r in enumerate(recordings)
    ]


def _at(motion: BuiltMotion, marks: IntArray, times: FloatArray) -> FloatArray:
    """Marks of a motion at some instants, linear between those kept, shape (frames, marks, 2)."""
    x = motion.positions[_LAY:, marks]
    before = np.minimum((times / INTERVAL).astype(int), len(x) - 2)
    part = (times / INTERVAL - before)[:, None, None]
    return x[before] * (1 - part) + x[before + 1] * part


def _lengths(on: FloatArray, springs: Sequence[Sequence[SpringParameters]]) -> list[FloatArray]:
    """Free lengths for `drive` of every robot, from the springs of its motors, all heated together."""
    motors = on.shape[1]
    each = [s for own in springs for s in own]
    state = SpringState(np.array([s.ambient for s in each]), np.ones(len(each)))
    history = heat(np.tile(on, (1, len(springs))), INTERVAL, each, state)
    cold = np.tile([s.cold_length for s in each], (_LAY + 1, 1))
    table = np.concatenate([cold, history.length])
    return [table[:, i * motors : (i + 1) * motors] for i in range(len(springs))]


def stayed_upright(rest: FloatArray, tracked: Trajectory) -> bool:
    """Whether marks that at `rest` (K, 2) [m] lie there were never turned as by a fall.

    The rotation is the one of `eldir.built.walking.rotation`, of the marks that are seen.
    """
    seen = np.isfinite(tracked.positions[..., 0])
    enough = seen.sum(axis=1) >= _LEAST_MARKS
    there = seen[enough][..., None]
    now = np.where(there, tracked.positions[enough], 0.0)
    drawn = np.where(there, rest, 0.0)
    number = there.sum(axis=1, keepdims=True)
    a, b = (there * (x - x.sum(axis=1, keepdims=True) / number) for x in (drawn, now))
    cross = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)
    turned = np.abs(np.arctan2(cross, (a * b).sum(axis=(1, 2))))
    step = np.diff(tracked.times, append=tracked.times[-1:])[enough]
    return bool(step[turned > TOPPLED].sum() <= _LONG_LYING)
