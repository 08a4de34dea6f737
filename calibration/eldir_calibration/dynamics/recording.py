"""Data of an identification: filmed runs, readings of scales and meters, and the requirements on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eldir.built.heat import SpringState, heat, join_hubs
from eldir.built.motion import PrintedMotion, drive
from eldir.built.robot import build
from eldir.built.walking import TOPPLED_ANGLE
from eldir.core.records import FloatArray, IntArray, Record
from eldir.errors import InputError
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.trajectory import Trajectory
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig

Progress = Callable[[str, float], None]
"""Called with the present step and the fraction of it that is done, 0 to 1."""
INTERVAL = 0.05
"""Time between the instants at which free lengths are given [s]."""
_REST_INTERVALS = 30
"""Intervals that a robot with cold springs stands before the film begins, until it is in equilibrium."""
_MIN_LYING_TIME = 1.0  # total time rotated that counts as a fall; less may be a mistaken marker [s]


@dataclass(frozen=True, eq=False)
class FilmedBody(Record):
    """The robot that was filmed: its body, and which masses carry markers."""

    morphology: Morphology
    marker_masses: IntArray
    """Mass indices of the markers, shape (K,)."""
    ballast: FloatArray | float = 0.0
    """Ballast on this plane, as `eldir.built.robot.build` takes it [kg]."""


@dataclass(frozen=True, eq=False)
class Recording(Record):
    """One run of a robot, from rest and cold."""

    tracked: Trajectory
    """The markers; NaN where they were not visible."""
    contact_shares: FloatArray
    """Share of each interval in which each motor's contacts were closed, shape (steps, A)."""
    start: float
    """When the first cycle that counts begins [s]."""
    period: float
    """Duration of a cycle [s]."""
    cycles: int
    fell_at: float | None = None
    """When the robot fell over sideways, after which its markers were not seen again [s]; None: it did not,
    as far as the film shows."""
    room_c: float | None = None
    """Temperature of the air before the run [C]; None: it was not measured, and is that of the robot's
    springs."""
    lost_at: float | None = None
    """When its markers vanished for good without a sign of a fall: it fell, left the picture or was covered
    [s]; None: they did not."""

    def truncate(self, end: float) -> Recording:
        """The part of the recording before `end` [s]."""
        t = self.tracked.times
        kept = t <= end + 1e-9
        return Recording(
            Trajectory(self.tracked.names, t[kept], self.tracked.positions[kept]),
            self.contact_shares[: int(np.ceil(end / INTERVAL - 1e-9)) + 1],
            self.start,
            self.period,
            max(0, int((end - self.start) / self.period + 1e-6)),
            room_c=self.room_c,
        )

    @property
    def end(self) -> float:
        """End of the last cycle [s]."""
        return self.start + self.period * self.cycles

    @property
    def frame_times(self) -> FloatArray:
        """Times of the frames, within the simulated time [s]."""
        return np.clip(self.tracked.times, 0.0, len(self.contact_shares) * INTERVAL)


def predict_markers(
    body: FilmedBody,
    recordings: Sequence[Recording],
    robots: Sequence[RobotParameters],
    *,
    coarse: bool = False,
) -> list[FloatArray]:
    """Motions of the markers of different robots of one body under each recording's heating, at its frames.

    One array (robots, frames, markers, 2) [m] for each recording; NaN from where a robot blew up. All
    run side by side in the engine's vector lanes, in the air of each recording. `coarse`: faster and less
    exact (`PrintedRobot.coarse`).
    """
    built = [build(body.morphology, robot, ballast=body.ballast) for robot in robots]
    if coarse:
        built = [robot.coarse() for robot in built]
    springs = [robot.motor_springs(body.morphology.motors) for robot in robots]
    free, hubs = (
        [robot.free_lengths for robot in robots],
        join_hubs([body.morphology.motor_hubs] * len(robots)),
    )
    tables = [table for r in recordings for table in _free_lengths(r, springs, hubs)]
    runs = len(recordings)
    motions = drive(built * runs, tables, INTERVAL, free=free * runs)
    return [
        np.stack(
            [
                _interpolate_markers(m, body.marker_masses, r.frame_times)
                for m in motions[k * len(robots) : (k + 1) * len(robots)]
            ]
        )
        for k, r in enumerate(recordings)
    ]


def _interpolate_markers(motion: PrintedMotion, marker_masses: IntArray, times: FloatArray) -> FloatArray:
    """Positions of the markers at some instants, interpolated linearly, shape (frames, markers, 2)."""
    x = motion.positions[_REST_INTERVALS:, marker_masses]
    before = np.minimum((times / INTERVAL).astype(int), len(x) - 2)
    part = (times / INTERVAL - before)[:, None, None]
    return x[before] * (1 - part) + x[before + 1] * part


def _free_lengths(
    recording: Recording, springs: Sequence[Sequence[SpringParameters]], hubs: IntArray
) -> list[FloatArray]:
    """Free lengths for `drive` of every robot, from the springs of its motors, all heated together. `hubs` of
    the motors of all robots, as `heat` takes them."""
    on = recording.contact_shares
    motors = on.shape[1]
    each = [s.in_air(recording.room_c) for own in springs for s in own]
    state = SpringState(np.array([s.ambient for s in each]), np.ones(len(each)))
    history = heat(np.tile(on, (1, len(springs))), INTERVAL, each, state, hubs=hubs)
    cold = np.tile([s.cold_length for s in each], (_REST_INTERVALS + 1, 1))
    table = np.concatenate([cold, history.length])
    return [table[:, i * motors : (i + 1) * motors] for i in range(len(springs))]


def find_fall(rest: FloatArray, tracked: Trajectory) -> float | None:
    """When a filmed robot first lay on its side [s]; None if it did so for less than a second in all. `rest`
    (K, 2) [m]: positions of its markers at rest.

    It lies where the lines between all pairs of visible markers have turned by more than
    `eldir.built.walking.TOPPLED_ANGLE` from rest: a motor turns some of them as far, but not all. Frames
    with fewer than `IdentificationConfig.min_markers` visible markers are ignored.
    """
    enough = np.isfinite(tracked.positions[..., 0]).sum(axis=1) >= DEFAULT_CONFIG.min_markers
    i, j = np.triu_indices(len(rest), 1)
    a, b = rest[j] - rest[i], (tracked.positions[:, j] - tracked.positions[:, i])[enough]
    turned = np.abs(np.arctan2(a[:, 0] * b[..., 1] - a[:, 1] * b[..., 0], (a * b).sum(axis=-1)))
    lies = ((turned > TOPPLED_ANGLE) | np.isnan(turned)).all(axis=1)
    step = np.diff(tracked.times, append=tracked.times[-1:])[enough]
    return float(tracked.times[enough][lies][0]) if step[lies].sum() > _MIN_LYING_TIME else None


def find_any_fall(rest: FloatArray, recording: Recording) -> float | None:
    """When a filmed robot fell, in its plane or sideways [s]; None if it did not. `rest` as in
    `find_fall`."""
    falls = [t for t in (find_fall(rest, recording.tracked), recording.fell_at) if t is not None]
    return min(falls, default=None)


@dataclass(frozen=True)
class Measurements:
    """Readings; None for a quantity that was not measured."""

    weight: float | None = None
    """Mass of one plane of the robot [kg]."""
    current: float | None = None
    """Current through one hot spring while no other is heated [A]; if springs differ, their mean."""
    voltage: float | None = None
    """Voltage across that spring, without its leads [V]."""
    error: float | None = None
    """Standard deviation of current and voltage, relative; None: that of a good meter."""

    def residuals(
        self,
        body: FilmedBody,
        robot: RobotParameters,
        config: IdentificationConfig = DEFAULT_CONFIG,
    ) -> FloatArray:
        """How far a robot is from the readings, in their standard deviations, shape (readings,)."""
        found = []
        error = config.meter_error if self.error is None else self.error
        if self.weight is not None:
            masses = build(body.morphology, robot, ballast=body.ballast).masses
            found.append(np.log(masses.sum() / self.weight) / config.weight_error)
        hot = robot.springs
        if self.current is not None:
            found.append(np.log(hot.current(0.0) / self.current) / error)
        if self.voltage is not None:
            across = hot.current(0.0) * hot.resistance_at(0.0)
            found.append(np.log(across / self.voltage) / error)
        return np.array(found)


NOT_MEASURED = Measurements()
"""No measurements: nobody weighed the robot or read a meter."""


def require_informative(
    recordings: Sequence[Recording], config: IdentificationConfig = DEFAULT_CONFIG
) -> None:
    """Raise `InputError` for films as `require_visible` does, and of a robot that does not move."""
    require_visible(recordings, config)
    for recording in recordings:
        if not moves(recording, config):
            raise InputError(
                "the robot hardly moves, so its log says nothing about its parameters",
                code="dynamics.hardly-moves",
                expected=f"a marker that rises and falls by {config.min_motion * 1e3:.0f} mm",
                found=f"{_rise(recording, config) * 1e3:.1f} mm",
                remedy="measure the current in a spring: cold ones do not move it; or try another gait",
            )


def moves(recording: Recording, config: IdentificationConfig = DEFAULT_CONFIG) -> bool:
    """Whether a marker of the robot rises and falls over the cycles that count."""
    return _rise(recording, config) >= config.min_motion


def _rise(recording: Recording, config: IdentificationConfig) -> float:
    """By how much the marker that moves most rises and falls over the cycles that count [m]."""
    x, share = _seen_cycles(recording)
    heights = x[:, share >= config.min_visible_share, 1]
    if not heights.size:
        return 0.0
    return float((np.nanmax(heights, axis=0) - np.nanmin(heights, axis=0)).max())


def _seen_cycles(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """The markers over the cycles that count, and the share of these frames in which each is seen."""
    times = recording.tracked.times
    x = recording.tracked.positions[(times >= recording.start) & (times <= recording.end)]
    return x, np.isfinite(x[..., 0]).mean(axis=0) if len(x) else np.zeros(x.shape[1])


def require_visible(recordings: Sequence[Recording], config: IdentificationConfig = DEFAULT_CONFIG) -> None:
    """Raise `InputError` for too few cycles or markers, and cold motors."""
    if not recordings or min(r.cycles for r in recordings) < config.min_cycles:
        raise InputError(
            "too few cycles to identify from",
            code="dynamics.too-few-cycles",
            expected=f"{config.min_cycles} or more, of which the last is held out",
            found=str(min((r.cycles for r in recordings), default=0)),
        )
    for r in recordings:
        _, share = _seen_cycles(r)
        seen = [name for name, s in zip(r.tracked.names, share, strict=True) if s >= config.min_visible_share]
        if len(seen) < config.min_markers:
            raise InputError(
                "too few markers to identify from",
                code="dynamics.too-few-marks",
                expected=f"{config.min_markers} or more, visible in {config.min_visible_share:.0%} of the "
                "frames",
                found=", ".join(seen) or "none",
                remedy="light the markers, or remove what hides them",
            )
        if not (r.contact_shares > 0).any():
            raise InputError(
                "no motor was ever heated",
                code="dynamics.never-heated",
                remedy="check the log's relay states",
            )


def require_explained(
    recordings: Sequence[Recording], left: float, config: IdentificationConfig = DEFAULT_CONFIG
) -> None:
    """Raise `InputError` for a fit that leaves too much of the motion, root mean square `left` [m]: it was
    another robot."""
    spread = [np.nanstd(r.tracked.positions[..., 1], axis=0) for r in recordings]
    moved = float(np.sqrt(np.nanmean(np.concatenate(spread) ** 2)))
    allowed = config.max_unexplained_share * moved
    if left > allowed:
        raise InputError(
            "no robot of this design moves like the one that was filmed",
            code="dynamics.unexplained",
            expected=f"at most {allowed * 1e3:.1f} mm unexplained",
            found=f"{left * 1e3:.1f} mm",
            remedy="check the design file, the order of the markers and the wiring",
        )
