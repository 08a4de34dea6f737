"""The report's main finding: whether the film agrees with the prediction, and where it agrees least.

The interval of a prediction is that of the uncertain robot, from samples of it, and not the scatter over the
cycles of one simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from eldir.core.records import FloatArray
from eldir_calibration.report.comparison import CycleMean, Motion, MotionReport
from eldir_calibration.report.sampled_motions import LEVEL, SampledMotions, prediction_interval, swings

RANGE, SWING = "vertical range", "horizontal swing"
_RESOLVED = 1e-4  # the tracker's error is 0.02 to 0.09 mm (docs/reference/vision.md) [m]
Agrees = Literal["agrees", "undecided", "disagrees"]
_AGREEMENT = {
    "agrees": "They agree: the film lies within the prediction's interval.",
    "undecided": "Not decided: the film lies outside the prediction's interval, but its own interval reaches "
    "inside.",
    "disagrees": "They disagree: the film lies outside the prediction's interval.",
}


@dataclass(frozen=True)
class Compared:
    """One quantity, predicted and filmed."""

    nominal: float
    """Prediction for the nominal robot, or for the most probable one."""
    predicted: CycleMean
    """Mean of the samples that stay upright, and the interval for one more robot."""
    tracked: CycleMean
    """Filmed, with its interval over cycles if there is one."""
    resolved: float = 0.0
    """Differences below it are not seen by the camera."""

    @property
    def agreement(self) -> Agrees | None:
        """Whether the film lies within the interval of the prediction; "undecided" if it lies outside, but
        its own interval reaches inside. None if either is unknown."""
        if not np.isfinite([self.predicted.low, self.predicted.high, self.tracked.mean]).all():
            return None
        if self.predicted.low <= self.tracked.mean <= self.predicted.high:
            return "agrees"
        if abs(self.tracked.mean - self.predicted.mean) < self.resolved:
            return "agrees"
        reaches = self.tracked.low <= self.predicted.high and self.predicted.low <= self.tracked.high
        return "undecided" if reaches else "disagrees"

    @property
    def distance(self) -> float:
        """Distance of the film from the mean of the samples, in half widths of the interval: beyond 1 it lies
        outside. NaN if unknown."""
        half = max((self.predicted.high - self.predicted.low) / 2, self.resolved)
        return abs(self.tracked.mean - self.predicted.mean) / half if half > 0 else math.nan


@dataclass(frozen=True)
class MarkMotion(Compared):
    """The size of the motion of one mark in one direction [m]."""

    mark: str = ""
    what: str = ""
    """Such as "vertical range"."""


@dataclass(frozen=True)
class ReportVerdict:
    """What was predicted, what was filmed, and whether they agree."""

    walk: Compared
    """Displacement [body lengths per five cycles]."""
    samples: int
    fell: int
    """Samples that fell, folded or buckled a coil."""
    motions: tuple[MarkMotion, ...]
    """Vertical range and horizontal swing of every mark."""

    @property
    def worst(self) -> MarkMotion | None:
        """The motion that disagrees most; None if none can be compared."""
        known = [m for m in self.motions if math.isfinite(m.distance)]
        return max(known, key=lambda m: m.distance, default=None)

    @property
    def sentence(self) -> str:
        """Whether they agree, in one sentence."""
        if self.walk.agreement is not None:
            return _AGREEMENT[self.walk.agreement]
        if not math.isfinite(self.walk.tracked.mean):
            return "Whether they agree cannot be said: nothing was filmed."
        return f"Whether they agree cannot be said: {_few(self)}."

    @property
    def text(self) -> str:
        """The verdict in words."""
        return " ".join([_walk_words(self), *_motion_words(self)])


def verdict_of(predicted: Motion, tracked: Motion, samples: SampledMotions | None) -> ReportVerdict:
    """Compare the film with the samples of the predicted robot; without samples nothing is decided."""
    names = tracked.trajectory.names
    samples = samples or SampledMotions.of([], len(names))
    walk = Compared(
        predicted.displacement(), prediction_interval(samples.walks), CycleMean.of(tracked.displacements())
    )
    motions: list[MarkMotion] = []
    filmed = [CycleMean.of(r) for r in tracked.vertical_ranges().T]
    one_film = [CycleMean(float(s), float(s), float(s)) for s in swings(tracked)]
    for what, nominal, of_samples, seen in (
        (RANGE, predicted.vertical_ranges().mean(axis=0), samples.ranges, filmed),
        (SWING, swings(predicted), samples.swings, one_film),
    ):
        for k, name in enumerate(names):
            column = of_samples[:, k] if len(of_samples) else np.zeros(0)
            motions.append(
                MarkMotion(float(nominal[k]), _size_interval(column), seen[k], _RESOLVED, name, what)
            )
    return ReportVerdict(walk, len(samples.walks), samples.fell, tuple(motions))


def with_sample_intervals(report: MotionReport, verdict: ReportVerdict) -> MotionReport:
    """The report with intervals of the samples, instead of those over cycles, for all that is predicted."""
    of_mark = {m.mark: m.predicted for m in verdict.motions if m.what == RANGE}
    ranges = [
        CycleMean(old.mean, of_mark[name].low, of_mark[name].high)
        for name, old in zip(report.names, report.ranges["predicted"], strict=True)
    ]
    walk = CycleMean(report.walked["predicted"].mean, verdict.walk.predicted.low, verdict.walk.predicted.high)
    return replace(
        report,
        ranges=report.ranges | {"predicted": ranges},
        walked=report.walked | {"predicted": walk},
    )


def _size_interval(values: FloatArray) -> CycleMean:
    found = prediction_interval(values)
    return CycleMean(found.mean, max(found.low, 0.0) if math.isfinite(found.low) else found.low, found.high)


def _few(v: ReportVerdict) -> str:
    return f"only {v.samples - v.fell} of {v.samples} samples stay upright" if v.samples else "no samples"


def _walk_words(v: ReportVerdict) -> str:
    walk, filmed = v.walk, v.walk.tracked
    interval = f" ({filmed.low:+.2f} to {filmed.high:+.2f} over cycles)" if math.isfinite(filmed.low) else ""
    camera = f"Filmed: {filmed.mean:+.2f}{interval}." if math.isfinite(filmed.mean) else "Nothing was filmed."
    if walk.agreement is None:
        alone = f"{walk.nominal:+.2f} body lengths per five cycles, for the most probable parameters"
        return f"Predicted: {alone}. {camera} Whether they agree cannot be said: {_few(v)}."
    p = walk.predicted
    falls = f"; {v.fell} of {v.samples} samples fall" if v.fell else ""
    predicted = (
        f"Predicted: {p.mean:+.2f} body lengths per five cycles, {p.low:+.2f} to {p.high:+.2f} for "
        f"{100 * LEVEL:.0f} % of robots like this one ({walk.nominal:+.2f} for the most probable "
        f"parameters{falls})."
    )
    return f"{predicted} {camera} {v.sentence}"


def _motion_words(v: ReportVerdict) -> list[str]:
    worst = v.worst
    if worst is None:
        return []
    known = [m for m in v.motions if m.agreement is not None]
    outside = sum(m.agreement != "agrees" for m in known)
    p = worst.predicted
    place, differs = ("within", "differs") if worst.agreement == "agrees" else ("outside", "disagrees")
    return [
        f"The {worst.what} of {worst.mark} {differs} most: predicted {1e3 * p.mean:.1f} mm "
        f"({1e3 * p.low:.1f} to {1e3 * p.high:.1f}), filmed {1e3 * worst.tracked.mean:.1f} mm, {place} the "
        f"interval; {outside} of {len(known)} ranges and swings lie outside."
    ]
