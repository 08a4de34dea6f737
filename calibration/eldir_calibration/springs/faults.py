"""Samples of a recording that are faults of a sensor: named, and left out of the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir.errors import InputError

_MAX_SHARE = 0.1
"""A recording with a larger share of such samples is refused."""
_FALSE_ALARM = 0.01
"""Probability at which a run of equal values in a whole recording counts as chance."""
_MIN_RUN = 5
_OUTLIER = 6.0  # robust standard deviations
_NEIGHBOURS = 0.2  # a single sample of the current that differs by this part of the peak from both beside it


@dataclass(frozen=True)
class Fault:
    """Consecutive samples that are not the spring's."""

    quantity: str
    """temperature, current or length."""
    first_s: float
    last_s: float
    samples: int
    value: float
    """Their median, in the table's unit."""

    def __str__(self) -> str:
        when = (
            f"at {self.first_s:g} s" if self.samples == 1 else f"from {self.first_s:g} to {self.last_s:g} s"
        )
        unit = {"temperature": "C", "current": "A", "length": "mm"}[self.quantity]
        return f"{self.quantity} {when}: {self.samples} x {self.value:.4g} {unit}"


def list_faults(quantity: str, bad: BoolArray, time: FloatArray, values: FloatArray) -> list[Fault]:
    """The bad samples of one quantity, consecutive ones together."""
    at = np.flatnonzero(bad)
    runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(at) else []
    return [
        Fault(quantity, float(time[r[0]]), float(time[r[-1]]), len(r), float(np.median(values[r])))
        for r in runs
    ]


def stuck_samples(values: FloatArray) -> BoolArray:
    """Samples in runs of equal values longer than chance explains: a sensor that is stuck or at its limit.

    How often neighbours are equal by chance, because numbers are rounded, is counted in the recording.
    """
    equal = np.concatenate([[False], np.diff(values) == 0.0, [False]])
    chance = float(np.clip(equal.mean(), 1e-6, 1.0 - 1e-6))
    longest = max(_MIN_RUN, 2 + int(np.ceil(np.log(_FALSE_ALARM / len(values)) / np.log(chance))))
    edges = np.flatnonzero(np.diff(equal.astype(int)))
    stuck = np.zeros(len(values), bool)
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        stuck[a : b + 1] = b - a + 1 >= longest
    return stuck


def outliers(model: FloatArray, measured: FloatArray, noise: float) -> BoolArray:
    """Samples far from the model, where the measured value jumps away from it and back.

    Where it leaves the model without a jump, the model is wrong, or the sensor lags: that is no fault, and
    the residual tells it. A jump is larger than the noise and twice the model's own change.
    """
    residuals = measured - model
    spread = max(1.4826 * float(np.median(np.abs(residuals))), noise)
    far = np.abs(residuals) > _OUTLIER * spread
    jump = np.abs(np.diff(residuals)) > _OUTLIER * noise + 2.0 * np.abs(np.diff(model))
    jump = np.concatenate([[True], jump, [True]])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], far, [False]]).astype(int)))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        far[a:b] = jump[a] and jump[b]
    return far


def single_jumps(current: FloatArray) -> BoolArray:
    """Single samples of the current that differ from both neighbours, which agree."""
    limit = _NEIGHBOURS * float(np.max(current))
    before, here, after = current[:-2], current[1:-1], current[2:]
    jumps = np.zeros(len(current), bool)
    jumps[1:-1] = (np.abs(before - after) < limit / 2) & (np.abs(here - (before + after) / 2) > limit)
    return jumps


def noise_of(values: FloatArray) -> float:
    """Standard deviation of the noise in samples (N,), from second differences and from rounding."""
    scatter = 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / np.sqrt(6.0)
    steps = np.abs(np.diff(values))
    rounding = float(steps[steps > 0].min(initial=np.inf)) / np.sqrt(12.0)
    return max(scatter, rounding if np.isfinite(rounding) else 0.0)


def require_few(faults: list[Fault], total: int) -> None:
    """Raise `InputError` where too many samples are faults, with the longest of them."""
    count = sum(f.samples for f in faults)
    if count > _MAX_SHARE * total:
        longest = max(faults, key=lambda f: f.samples)
        raise InputError(
            "too many samples are not those of a heated spring",
            code="spring.faulty-samples",
            expected=f"at most {_MAX_SHARE:.0%} of {total}",
            found=f"{count}, such as {longest}",
            remedy="check the thermocouple and its wires, then record again",
        )
