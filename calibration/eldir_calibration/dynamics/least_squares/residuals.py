"""Residuals of a film: camera minus prediction, so that neither drift nor a mark's place counts twice.

A robot slips a little differently in every step, and the difference stays from then on. So the common motion
of the marks counts from second to second, and the motion of each mark relative to the others from frame to
frame. Where exactly a mark was glued on, and where the plane lies, only changes the mean, which is removed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir_calibration.dynamics.recording import Recording

_SECOND = 1.0


@dataclass(frozen=True)
class Residual:
    """Residual of one recording: linear in the difference of positions; leading axes are kept."""

    shape: FloatArray
    """Heights, and forward places relative to the marks' mean, less their means over time [m],
    shape (..., frames, 2 marks); 0 where a mark was not seen."""
    walk: FloatArray
    """How far the marks' mean went forward in each second [m], shape (..., seconds)."""

    def scaled(self, shape: float, walk: float) -> FloatArray:
        """One vector, in standard deviations, shape (..., values)."""
        flat = self.shape.reshape(*self.shape.shape[:-2], -1)
        return np.concatenate([flat / shape, self.walk / walk], axis=-1)


def residual(recording: Recording, apart: FloatArray) -> Residual:
    """The residual of differences `apart` (..., frames, marks, 2) [m] between tracked and predicted marks."""
    seen: BoolArray = np.isfinite(recording.tracked.positions[..., 0])  # (frames, marks)
    apart = np.where(seen[..., None], apart, 0.0)
    number = np.maximum(seen.sum(axis=1), 1)
    forward = apart[..., 0].sum(axis=-1) / number  # of the marks' mean, (..., frames)
    parts = np.concatenate([apart[..., 0] - forward[..., None], apart[..., 1]], axis=-1)
    there = np.concatenate([seen, seen], axis=1)
    parts = np.where(there, parts, 0.0)
    mean = parts.sum(axis=-2, keepdims=True) / np.maximum(there.sum(axis=0), 1)
    walk = _each_second(recording, forward, seen.sum(axis=1) > 0)
    return Residual(np.where(there, parts - mean, 0.0), walk)


def _each_second(recording: Recording, forward: FloatArray, seen: BoolArray) -> FloatArray:
    """Differences between the means over neighbouring seconds; 0 beside a second without a frame."""
    second = (recording.tracked.times / _SECOND).astype(int)
    second -= second.min(initial=0)
    count = int(second.max(initial=0)) + 1
    number = np.bincount(second[seen], minlength=count)
    averaging = np.zeros((len(second), count))
    averaging[seen, second[seen]] = 1.0 / number[second[seen]]
    means = forward @ averaging
    sound = (number[1:] > 0) & (number[:-1] > 0)
    return np.where(sound, np.diff(means, axis=-1), 0.0)
