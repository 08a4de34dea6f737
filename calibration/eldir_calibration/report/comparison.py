"""Compares three motions: learned in simulation, predicted for the printed robot, filmed by the camera.

A matching profile of vertical ranges alone is weak evidence: it fits nearly any robot of that shape
(docs/reference/report.md). So displacement, horizontal motion and a null are compared as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.special import stdtrit

from eldir.built.gait import CYCLES
from eldir.core.records import FloatArray, Record, Rounded, record
from eldir.errors import InputError
from eldir.trajectory import MAX_TIME_GAP, Trajectory, height_ranges, interpolate_near, mean_known

PHASE_SAMPLES = 100
"""Samples of a cycle."""
MOTION_NAMES = {"simulated": "learned", "predicted": "predicted", "tracked": "filmed"}
"""The name of each motion for people, by its key in JSON: learned by the neural controller in the paper's
scene; predicted for the printed robot under the schedule of the run; filmed by the camera."""
MOTION_KINDS = tuple(MOTION_NAMES)
NOT_COMPARABLE = (
    "Learned and predicted are not comparable: the paper's scene has no hubs, other springs, weights and "
    "friction, and the controller's own pace. Only the filmed walk tests the predicted one."
)
_MAX_MISSING_FRAMES = 2
_MIN_DIFFERENCE = 1e-9  # a prediction this close to the camera was not computed independently [m]


@dataclass(frozen=True, eq=False)
class Motion(Record):
    """Marked masses over whole actuation cycles. A mass has a place at an instant only if it was seen within
    `MAX_TIME_GAP` of the period of it."""

    trajectory: Trajectory
    start: float
    """When the first cycle that counts begins [s]."""
    period: float
    """Duration of a cycle [s]."""
    cycles: int
    body_length: float
    """Body length of this robot [m]."""
    scale: float = 1.0
    """Metres of the printed robot per metre of this trajectory."""

    def __post_init__(self) -> None:
        end = self.start + self.period * self.cycles
        t = self.trajectory.times
        missing = max_missing_time(t) + 1e-6 * self.period
        if len(t) < 2 or t[0] > self.start + missing or t[-1] < end - missing:
            found = f"{t[0]:.3g} to {t[-1]:.3g} s" if len(t) else "nothing"
            raise InputError(
                "a motion does not cover its cycles",
                code="report.cycles-not-covered",
                expected=f"{self.start:.3g} to {end:.3g} s",
                found=found,
            )

    @property
    def visible_share(self) -> FloatArray:
        """Share of instants within the cycles at which each mass was seen, shape (K,)."""
        t = self.trajectory.times
        inside = (t >= self.start) & (t <= self.start + self.period * self.cycles)
        measured = np.isfinite(self.trajectory.positions[:, :, 0]) & ~self.trajectory.bridged
        return measured[inside].mean(axis=0)

    @property
    def _counted_frames(self) -> tuple[FloatArray, FloatArray]:
        t = self.trajectory.times
        inside = (t >= self.start) & (t <= self.start + self.period * self.cycles)
        return t[inside], self.trajectory.positions[inside] * self.scale

    def vertical_ranges(self) -> FloatArray:
        """Greatest minus least height in each cycle [m at the built pitch], shape (cycles, K); NaN for a mass
        that has no place in a part of the cycle."""
        t, x = self._counted_frames
        cycle = np.minimum(((t - self.start) / self.period).astype(int), self.cycles - 1)
        ranges = np.full((self.cycles, x.shape[1]), np.nan)
        for c in range(self.cycles):
            ranges[c] = height_ranges(x[cycle == c, :, 1])
        ranges[~np.isfinite(self.by_phase()).all(axis=(1, 3))] = np.nan
        return ranges

    def by_phase(self) -> FloatArray:
        """Positions at equal phases of every cycle [m], shape (cycles, PHASE_SAMPLES, K, 2)."""
        phases = (np.arange(self.cycles * PHASE_SAMPLES) + 0.5) / PHASE_SAMPLES
        t, x = self.trajectory.times, self.trajectory.positions * self.scale
        found = self._interpolate(t, x.reshape(len(t), -1), self.start + phases * self.period)
        return found.reshape(self.cycles, PHASE_SAMPLES, x.shape[1], 2)

    def advance(self) -> tuple[FloatArray, FloatArray]:
        """Cycles since the start, and mean forward motion in body lengths: at each instant of the masses that
        have a place there and had one at the start; NaN where none has."""
        t, x = self._counted_frames
        filled = self._interpolate(t, x[:, :, 0], t)
        moved = mean_known(filled - filled[0], axis=1)
        return (t - self.start) / self.period, moved / (self.body_length * self.scale)

    def displacement(self) -> float:
        """Forward motion of the masses in body lengths per five cycles, over the cycles in which it is
        known."""
        return CycleMean.of(self.displacements()).mean

    def displacements(self) -> FloatArray:
        """Forward motion in each cycle, in body lengths per five cycles, shape (cycles,): of the masses that
        have a place at both ends of the cycle; NaN where none has."""
        ends = self.start + np.arange(self.cycles + 1) * self.period
        t, x = self.trajectory.times, self.trajectory.positions[:, :, 0]
        moved = mean_known(np.diff(self._interpolate(t, x, ends), axis=0), axis=1)
        return moved / self.body_length * CYCLES

    @property
    def known_cycles(self) -> int:
        """Number of cycles in which the forward motion is known."""
        return int(np.isfinite(self.displacements()).sum())

    def _interpolate(self, times: FloatArray, values: FloatArray, instants: FloatArray) -> FloatArray:
        return interpolate_near(times, values, instants, MAX_TIME_GAP * self.period)


def max_missing_time(times: FloatArray) -> float:
    """How much of complete cycles may be missing at either end [s]: as much as two frames take."""
    return _MAX_MISSING_FRAMES * float(np.median(np.diff(times))) if len(times) > 1 else 0.0


@dataclass(frozen=True)
class CycleMean:
    """A mean over cycles with its 95 % confidence interval (Student's t)."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, values: FloatArray) -> CycleMean:
        """The mean of one value a cycle; cycles without a value do not count."""
        good = np.asarray(values)[np.isfinite(values)]
        if len(good) == 0:
            return cls(float("nan"), float("nan"), float("nan"))
        mean = float(good.mean())
        if len(good) == 1:
            return cls(mean, float("nan"), float("nan"))
        half = float(stdtrit(len(good) - 1, 0.975) * good.std(ddof=1) / np.sqrt(len(good)))
        return cls(mean, mean - half, mean + half)


@record
class Agreement(Record):
    """Agreement of a motion with the camera's, phase by phase, for one mass and one direction."""

    correlation: Annotated[float, Rounded(9, ge=-1, le=1)]
    """Correlation of both motions over a mean cycle; null if unknown."""
    error: Annotated[float, Rounded(9, ge=0)]
    """Root mean square over a mean cycle, as in `mean_cycle` [m]."""
    null: Annotated[float, Rounded(9, ge=0, le=1)]
    """Mean absolute correlation when the phase is shifted: what chance alone gives."""
    rank: Annotated[float, Rounded(9, ge=0, le=1)]
    """Share of all phases at which it would correlate as well or better."""


@dataclass(frozen=True, eq=False)
class MotionReport(Record):
    """The comparison of three motions of K masses."""

    names: tuple[str, ...]
    ranges: dict[str, list[CycleMean]]
    """Vertical range of motion of each kind and mass [m at the built pitch]."""
    displacement: dict[str, float]
    """Displacement of each kind of motion, in body lengths per five cycles."""
    displacement_intervals: dict[str, CycleMean]
    """Displacement of each kind of motion, with its interval over cycles."""
    agreement: dict[str, list[dict[str, Agreement]]]
    """Agreement of 'simulated' and 'predicted' with 'tracked': for each mass, 'horizontal' and 'vertical'."""
    body_length: float
    """Body length at the built pitch [m]."""
    visible_share: FloatArray
    """Share of frames in which the camera saw each mass, shape (K,)."""
    warnings: tuple[str, ...]


def compare_motions(simulated: Motion, predicted: Motion, tracked: Motion) -> MotionReport:
    """Compare motions of the same masses; the camera is the reference. Raises `InputError` where the masses
    differ."""
    motions = dict(zip(MOTION_KINDS, (simulated, predicted, tracked), strict=True))
    names = tracked.trajectory.names
    for kind, motion in motions.items():
        if motion.trajectory.names != names:
            raise InputError(
                f"the {kind} motion is of different masses",
                code="report.different-masses",
                expected=", ".join(names),
                found=", ".join(motion.trajectory.names),
            )
    folded = {kind: motion.by_phase() for kind, motion in motions.items()}
    # A simulated cycle has no absolute phase, so it gets the lag that fits best.
    lags = {"simulated": best_lag(folded["simulated"], folded["tracked"]), "predicted": 0}
    return MotionReport(
        names=names,
        ranges={k: [CycleMean.of(r) for r in m.vertical_ranges().T] for k, m in motions.items()},
        displacement={k: m.displacement() for k, m in motions.items()},
        displacement_intervals={k: CycleMean.of(m.displacements()) for k, m in motions.items()},
        agreement={k: agreements(folded[k], folded["tracked"], lag) for k, lag in lags.items()},
        body_length=tracked.body_length * tracked.scale,
        visible_share=tracked.visible_share,
        warnings=tuple(_warnings(motions, folded)),
    )


def mean_cycle(folded: FloatArray) -> FloatArray:
    """The mean over cycles, shape (PHASE_SAMPLES, K, 2), without its mean, and horizontally without the
    steady walk. Of each mass those cycles count in which it has a place throughout; NaN if there is none.

    Any two robots that walk the same way would otherwise correlate.
    """
    return np.stack([_mean_whole_cycle(x) for x in np.moveaxis(folded, 2, 0)], axis=1)


def _mean_whole_cycle(x: FloatArray) -> FloatArray:
    """As `mean_cycle`, of one mass: shapes (cycles, PHASE_SAMPLES, 2) and (PHASE_SAMPLES, 2)."""
    whole = np.flatnonzero(np.isfinite(x).all(axis=(1, 2)))
    if not len(whole):
        return np.full(x.shape[1:], np.nan)
    first, last = whole[0], whole[-1]
    # From cycle to cycle: a straight line fitted within one would take part of the swing away.
    step = (x[last] - x[first]).mean(axis=0) / (last - first) if last > first else x[first, -1] - x[first, 0]
    mean = x[whole].mean(axis=0)
    mean[:, 0] -= np.linspace(0, 1, PHASE_SAMPLES, endpoint=False) * step[0]
    return mean - mean.mean(axis=0)


def agreements(folded: FloatArray, reference: FloatArray, lag: int = 0) -> list[dict[str, Agreement]]:
    """Agreement of each mass and direction; arrays as from `Motion.by_phase`, the first delayed by `lag`
    samples."""
    a, b = np.roll(mean_cycle(folded), lag, axis=0), mean_cycle(reference)
    found = []
    for k in range(a.shape[1]):
        both = {}
        for axis, direction in enumerate(("horizontal", "vertical")):
            u, v = a[:, k, axis], b[:, k, axis]
            every = np.array([_correlation(np.roll(u, s), v) for s in range(PHASE_SAMPLES)])
            null = float(np.mean(np.abs(every[PHASE_SAMPLES // 8 :: PHASE_SAMPLES // 8])))
            rank = float(np.mean(every >= every[0] - 1e-12)) if np.isfinite(every).all() else float("nan")
            error = float(np.sqrt(np.mean((u - v) ** 2)))
            both[direction] = Agreement(float(every[0]), error, null, rank)
        found.append(both)
    return found


def best_lag(folded: FloatArray, reference: FloatArray) -> int:
    """The shift in phase samples at which the heights of all masses correlate best."""
    a, b = mean_cycle(folded)[..., 1].T, mean_cycle(reference)[..., 1].T
    pairs = [(u, v) for u, v in zip(a, b, strict=True) if np.isfinite(u).all() and np.isfinite(v).all()]
    scores = [sum(_correlation(np.roll(u, s), v) for u, v in pairs) for s in range(PHASE_SAMPLES)]
    return int(np.argmax(scores))


def _correlation(u: FloatArray, v: FloatArray) -> float:
    u, v = u - u.mean(), v - v.mean()
    size = float(np.sqrt((u @ u) * (v @ v)))
    return 0.0 if size == 0 else float(u @ v) / size


def _warnings(motions: dict[str, Motion], folded: dict[str, FloatArray]) -> list[str]:
    warnings = []
    names = motions["tracked"].trajectory.names
    if len(names) < 5:
        warnings.append(f"Only {len(names)} masses lie on the rear edge of this design; five are usual.")
    difference = np.abs(folded["predicted"] - folded["tracked"])
    if np.isfinite(difference).all() and difference.max() < _MIN_DIFFERENCE:
        warnings.append(
            "The prediction equals the camera, so one was computed from the other. This is a bug."
        )
    for name, share in zip(names, motions["tracked"].visible_share, strict=True):
        if share < 0.95:
            warnings.append(f"The camera saw {name} in only {share:.0%} of the frames.")
    return warnings
