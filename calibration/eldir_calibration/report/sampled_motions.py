"""Motions of samples of the uncertain robot under the same schedule, and the intervals that they give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from eldir.core.records import FloatArray, Record
from eldir_calibration.report.comparison import CycleMean, Motion, mean_cycle

LEVEL = 0.95
"""Probability of the interval of a prediction."""


@dataclass(frozen=True, eq=False)
class SampledMotions(Record):
    """Motions of n samples of a robot with K marks. A sample that falls, folds or buckles a coil is minus
    infinity in `walks` and NaN elsewhere."""

    walks: FloatArray
    """Displacement [body lengths per five cycles], shape (n,)."""
    ranges: FloatArray
    """Vertical range of motion of each mark [m], shape (n, K)."""
    swings: FloatArray
    """Horizontal swing of each mark [m], shape (n, K)."""

    @classmethod
    def of(cls, motions: Sequence[Motion | None], marks: int) -> SampledMotions:
        """The motions of all samples; None for one that fell."""
        lost = np.full(marks, np.nan)
        return cls(
            np.array([-np.inf if m is None else m.displacement() for m in motions]),
            np.array([lost if m is None else m.vertical_ranges().mean(axis=0) for m in motions]),
            np.array([lost if m is None else swings(m) for m in motions]),
        )

    @property
    def fell(self) -> int:
        """Number of samples that fell, folded or buckled a coil."""
        return int((~np.isfinite(self.walks)).sum())


def swings(motion: Motion) -> FloatArray:
    """Horizontal swing of each mark: greatest minus least place in the mean cycle, without the steady walk
    [m], shape (K,)."""
    return np.ptp(mean_cycle(motion.by_phase())[..., 0], axis=0)


def prediction_interval(values: FloatArray, level: float = LEVEL) -> CycleMean:
    """Mean of samples, and the interval for one more robot that stays upright.

    The interval is mean +- t s sqrt(1 + 1/n), with Student's t for n - 1 degrees of freedom. Values that are
    not finite do not count.
    """
    good = np.asarray(values)[np.isfinite(values)]
    n = len(good)
    mean = float(good.mean()) if n else float("nan")
    if n < 2:
        return CycleMean(mean, float("nan"), float("nan"))
    reach = float(stdtrit(n - 1, (1 + level) / 2) * good.std(ddof=1) * np.sqrt(1 + 1 / n))
    return CycleMean(mean, mean - reach, mean + reach)
