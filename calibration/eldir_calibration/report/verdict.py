"""The report's main finding: whether the film agrees with the prediction, and where it agrees least.

The interval of a prediction is that of the uncertain robot, from samples of it, and not the scatter over the
cycles of one simulation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np

from eldir.built.samples import CONFIDENCE_LEVEL, interval_reach
from eldir.core.records import FloatArray, Record, Rounded, record
from eldir_calibration.report.comparison import CycleMean, Motion, MotionReport, mean_cycle

VERTICAL_RANGE, HORIZONTAL_SWING = "vertical range", "horizontal swing"
_RESOLUTION = 1e-4  # the tracker's error is 0.02 to 0.09 mm (docs/reference/vision.md) [m]
_AGREEMENT_SENTENCES = {
    "agrees": "They agree: the film lies within the prediction's interval.",
    "undecided": "Not decided: the film lies outside the prediction's interval, but its own interval reaches "
    "inside.",
    "disagrees": "They disagree: the film lies outside the prediction's interval.",
}
_HOW_LOST = {"fell": "fell over", "fell sideways": "fell over sideways", "lost": "was lost"}


@record
class RobotLoss(Record):
    """The robot fell, or all its markers vanished for good: what was filmed from then on is no walk."""

    time_s: Annotated[float, Rounded(3, ge=0)]
    """When it first lay on its side, or when a marker was last seen [s since the start of the run]."""
    kind: Literal["fell", "fell sideways", "lost"]
    """fell: it toppled in its plane of motion; fell sideways: the strips between its markers looked shorter,
    then no marker was seen; lost: no marker was seen, because it fell, left the picture or was covered."""

    @property
    def phrase(self) -> str:
        """What the robot did, and when."""
        return f"{_HOW_LOST[self.kind]} at {self.time_s:.1f} s"


@dataclass(frozen=True, eq=False)
class SampledMotions(Record):
    """Motions of n samples of a robot with K markers. A sample that falls, folds or buckles a coil is minus
    infinity in `walks` and NaN elsewhere."""

    walks: FloatArray
    """Displacement [body lengths per five cycles], shape (n,)."""
    ranges: FloatArray
    """Vertical range of motion of each marker [m], shape (n, K)."""
    swings: FloatArray
    """Horizontal swing of each marker [m], shape (n, K)."""

    @classmethod
    def of(cls, motions: Sequence[Motion | None], markers: int) -> SampledMotions:
        """The motions of all samples; None for one that fell."""
        lost = np.full(markers, np.nan)
        return cls(
            np.array([-np.inf if m is None else m.displacement() for m in motions]),
            np.array([lost if m is None else m.vertical_ranges().mean(axis=0) for m in motions]),
            np.array([lost if m is None else horizontal_swings(m) for m in motions]),
        )

    @property
    def fell(self) -> int:
        """Number of samples that fell, folded or buckled a coil."""
        return int((~np.isfinite(self.walks)).sum())


def horizontal_swings(motion: Motion) -> FloatArray:
    """Horizontal swing of each marker: greatest minus least place in the mean cycle, without the steady walk
    [m], shape (K,)."""
    return np.ptp(mean_cycle(motion.by_phase())[..., 0], axis=0)


def prediction_interval(values: FloatArray, level: float = CONFIDENCE_LEVEL) -> CycleMean:
    """Mean of samples, and the interval for one more robot that stays upright.

    The interval is mean +- t s sqrt(1 + 1/n), with Student's t for n - 1 degrees of freedom. Values that are
    not finite do not count.
    """
    good = np.asarray(values)[np.isfinite(values)]
    n = len(good)
    mean = float(good.mean()) if n else float("nan")
    if n < 2:
        return CycleMean(mean, float("nan"), float("nan"))
    reach = interval_reach(float(good.std(ddof=1)), n, level)
    return CycleMean(mean, mean - reach, mean + reach)


AgreementLevel = Literal["agrees", "undecided", "disagrees"]


@dataclass(frozen=True)
class ComparedQuantity:
    """One quantity, predicted and filmed."""

    nominal: float
    """Prediction for the nominal robot, or for the most probable one."""
    predicted: CycleMean
    """Mean of the samples that stay upright, and the interval for one more robot."""
    tracked: CycleMean
    """Filmed, with its interval over cycles if there is one."""
    resolution: float = 0.0
    """Differences below it are not seen by the camera."""
    is_test: bool = field(default=True, kw_only=True)
    """Whether a film within the interval shows that they agree: not where the robot was lost before the end
    of the run, or the prediction was fitted to this film."""

    @property
    def is_inside(self) -> bool:
        """Whether the film lies within the interval of the prediction, as far as the camera sees."""
        inside = self.predicted.low <= self.tracked.mean <= self.predicted.high
        return inside or abs(self.tracked.mean - self.predicted.mean) < self.resolution

    @property
    def agreement(self) -> AgreementLevel | None:
        """Whether the film lies within the interval of the prediction; "undecided" if it lies outside, but
        its own interval reaches inside, and if it lies within and is no test. None if either is unknown."""
        if not np.isfinite([self.predicted.low, self.predicted.high, self.tracked.mean]).all():
            return None
        if self.is_inside:
            return "agrees" if self.is_test else "undecided"
        reaches = self.tracked.low <= self.predicted.high and self.predicted.low <= self.tracked.high
        return "undecided" if reaches else "disagrees"

    @property
    def distance(self) -> float:
        """Distance of the film from the mean of the samples, in half widths of the interval: beyond 1 it lies
        outside. NaN if unknown."""
        half = max((self.predicted.high - self.predicted.low) / 2, self.resolution)
        return abs(self.tracked.mean - self.predicted.mean) / half if half > 0 else math.nan


@dataclass(frozen=True)
class MarkerMotion(ComparedQuantity):
    """The size of the motion of one marker in one direction [m]."""

    marker: str = ""
    quantity: str = ""
    """`VERTICAL_RANGE` or `HORIZONTAL_SWING`."""


@dataclass(frozen=True)
class ReportVerdict:
    """What was predicted, what was filmed, and whether they agree."""

    walk: ComparedQuantity
    """Displacement [body lengths per five cycles]."""
    samples: int
    fell: int
    """Samples that fell, folded or buckled a coil."""
    motions: tuple[MarkerMotion, ...]
    """Vertical range and horizontal swing of every marker."""
    film_error: float = 0.0
    """By how much the film's interval is wider because the robot left its plane [body lengths per five
    cycles]."""
    loss: RobotLoss | None = None
    """When the robot fell or got out of sight before the end of the run; None where it did not."""
    no_test: str = ""
    """Another reason why a film within the interval is no test, such as that the prediction was fitted to it;
    empty if it is one."""

    @property
    def worst(self) -> MarkerMotion | None:
        """The motion that disagrees most; None if none can be compared."""
        known = [m for m in self.motions if math.isfinite(m.distance)]
        return max(known, key=lambda m: m.distance, default=None)

    @property
    def sentence(self) -> str:
        """Whether they agree, in one sentence; in further ones why the film is no test of it."""
        if self.walk.agreement is not None:
            sentence = _AGREEMENT_SENTENCES[self.walk.agreement]
            if self.walk.is_inside and not self.walk.is_test:
                sentence = "Not decided: the film lies within the prediction's interval."
        elif not math.isfinite(self.walk.tracked.mean):
            sentence = "It is unknown whether they agree: the film does not show how far the robot walked."
        else:
            sentence = f"It is unknown whether they agree: {_too_few_samples(self)}."
        lost = f"the robot {self.loss.phrase}; only cycles that ended before count" if self.loss else ""
        return " ".join([sentence, *(f"But {why}." for why in (lost, self.no_test) if why)])

    @property
    def text(self) -> str:
        """The verdict as sentences."""
        return " ".join([_describe_walk(self), *_describe_motions(self)])


def evaluate_prediction(
    predicted: Motion,
    tracked: Motion,
    samples: SampledMotions | None,
    film_error: float = 0.0,
    *,
    loss: RobotLoss | None = None,
    no_test: str = "",
) -> ReportVerdict:
    """Compare the film with the samples of the predicted robot; without samples nothing is decided.
    `film_error`: of the filmed walk of a robot that left its plane [body lengths per five cycles]; `loss`: of
    a robot that fell or got out of sight; `no_test`: another reason why an agreement would be no test."""
    names = tracked.trajectory.names
    samples = samples or SampledMotions.of([], len(names))
    walk = ComparedQuantity(
        predicted.displacement(),
        prediction_interval(samples.walks),
        _widen(CycleMean.of(tracked.displacements()), film_error),
        is_test=loss is None and not no_test,
    )
    motions: list[MarkerMotion] = []
    range_means = [CycleMean.of(r) for r in tracked.vertical_ranges().T]
    swing_values = [CycleMean(float(s), float(s), float(s)) for s in horizontal_swings(tracked)]
    for quantity, nominal, sampled, tracked_means in (
        (VERTICAL_RANGE, predicted.vertical_ranges().mean(axis=0), samples.ranges, range_means),
        (HORIZONTAL_SWING, horizontal_swings(predicted), samples.swings, swing_values),
    ):
        for k, name in enumerate(names):
            column = sampled[:, k] if len(sampled) else np.zeros(0)
            motions.append(
                MarkerMotion(
                    float(nominal[k]),
                    _nonnegative_interval(column),
                    tracked_means[k],
                    _RESOLUTION,
                    name,
                    quantity,
                    is_test=walk.is_test,
                )
            )
    return ReportVerdict(walk, len(samples.walks), samples.fell, tuple(motions), film_error, loss, no_test)


def with_sample_intervals(report: MotionReport, verdict: ReportVerdict) -> MotionReport:
    """The report with intervals of the samples, instead of those over cycles, for all that is predicted."""
    by_marker = {m.marker: m.predicted for m in verdict.motions if m.quantity == VERTICAL_RANGE}
    ranges = [
        CycleMean(old.mean, by_marker[name].low, by_marker[name].high)
        for name, old in zip(report.names, report.ranges["predicted"], strict=True)
    ]
    walk = CycleMean(
        report.displacement_intervals["predicted"].mean,
        verdict.walk.predicted.low,
        verdict.walk.predicted.high,
    )
    return replace(
        report,
        ranges=report.ranges | {"predicted": ranges},
        displacement_intervals=report.displacement_intervals | {"predicted": walk},
    )


def _widen(mean: CycleMean, error: float) -> CycleMean:
    """The mean with an interval that is wider by an error on both sides."""
    if error == 0.0:
        return mean
    low, high = (mean.low, mean.high) if math.isfinite(mean.low) else (mean.mean, mean.mean)
    return CycleMean(mean.mean, low - error, high + error)


def _nonnegative_interval(values: FloatArray) -> CycleMean:
    found = prediction_interval(values)
    return CycleMean(found.mean, max(found.low, 0.0) if math.isfinite(found.low) else found.low, found.high)


def _too_few_samples(v: ReportVerdict) -> str:
    return f"only {v.samples - v.fell} of {v.samples} samples stay upright" if v.samples else "no samples"


def _describe_walk(v: ReportVerdict) -> str:
    walk, filmed = v.walk, v.walk.tracked
    of = "over cycles and out of the plane" if v.film_error else "over cycles"
    interval = f" ({filmed.low:+.2f} to {filmed.high:+.2f} {of})" if math.isfinite(filmed.low) else ""
    camera = (
        f"Filmed: {filmed.mean:+.2f}{interval}."
        if math.isfinite(filmed.mean)
        else "The film does not show the walk."
    )
    if walk.agreement is None:
        alone = f"{walk.nominal:+.2f} body lengths per five cycles, for the most probable parameters"
        return f"Predicted: {alone}. {camera} {v.sentence}"
    p = walk.predicted
    falls = f"; {v.fell} of {v.samples} samples fall" if v.fell else ""
    predicted = (
        f"Predicted: {p.mean:+.2f} body lengths per five cycles, {p.low:+.2f} to {p.high:+.2f} for "
        f"{100 * CONFIDENCE_LEVEL:.0f} % of robots like this one ({walk.nominal:+.2f} for the most probable "
        f"parameters{falls})."
    )
    return f"{predicted} {camera} {v.sentence}"


def _describe_motions(v: ReportVerdict) -> list[str]:
    worst = v.worst
    if worst is None:
        return []
    known = [m for m in v.motions if m.agreement is not None]
    outside = sum(not m.is_inside for m in known)
    p = worst.predicted
    place, differs = ("within", "differs") if worst.is_inside else ("outside", "disagrees")
    return [
        f"The {worst.quantity} of {worst.marker} {differs} most: predicted {1e3 * p.mean:.1f} mm "
        f"({1e3 * p.low:.1f} to {1e3 * p.high:.1f}), filmed {1e3 * worst.tracked.mean:.1f} mm, {place} the "
        f"interval; {outside} of {len(known)} ranges and swings lie outside."
    ]
