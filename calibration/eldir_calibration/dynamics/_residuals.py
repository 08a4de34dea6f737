"""Residuals of a film: camera minus prediction, in the frames that can be predicted.

A robot slips a little differently in every step, and the difference stays from then on. So the common motion
of the markers counts from second to second, and the motion of each marker relative to the others from frame
to frame. Where exactly a marker was glued on, and where the plane lies, only changes the mean, which is
removed.

A landing goes one way or the other by the last micrometre. Mostly that does not matter: slightly perturbed
simulations agree again within a second. Where one of them tumbles and another does not, they diverge by
millimetres, and such frames say nothing about the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig
from eldir_calibration.dynamics.recording import Recording

_SECOND = 1.0


@dataclass(frozen=True)
class Residual:
    """Residual of one recording: linear in the difference of positions; leading axes are kept."""

    shape: FloatArray
    """Heights, and forward places relative to the markers' mean, less their means over time [m],
    shape (..., frames, 2 markers); 0 where a marker was not seen."""
    walk: FloatArray
    """How far the markers' mean went forward in each second [m], shape (..., seconds)."""

    def scale(self, shape: float, walk: float) -> FloatArray:
        """One vector, in standard deviations, shape (..., values)."""
        flat = self.shape.reshape(*self.shape.shape[:-2], -1)
        return np.concatenate([flat / shape, self.walk / walk], axis=-1)


def compute_residual(recording: Recording, differences: FloatArray) -> Residual:
    """The residual of the differences (..., frames, markers, 2) [m] between tracked and predicted
    markers."""
    seen: BoolArray = np.isfinite(recording.tracked.positions[..., 0])  # (frames, markers)
    differences = np.where(seen[..., None], differences, 0.0)
    counts = np.maximum(seen.sum(axis=1), 1)
    forward = differences[..., 0].sum(axis=-1) / counts  # of the markers' mean, (..., frames)
    parts = np.concatenate([differences[..., 0] - forward[..., None], differences[..., 1]], axis=-1)
    visible = np.concatenate([seen, seen], axis=1)
    parts = np.where(visible, parts, 0.0)
    mean = parts.sum(axis=-2, keepdims=True) / np.maximum(visible.sum(axis=0), 1)
    walk = _walk_per_second(recording, forward, seen.sum(axis=1) > 0)
    return Residual(np.where(visible, parts - mean, 0.0), walk)


def _walk_per_second(recording: Recording, forward: FloatArray, seen: BoolArray) -> FloatArray:
    """Differences between the means over neighbouring seconds; 0 beside a second without a frame."""
    second = (recording.tracked.times / _SECOND).astype(int)
    second -= second.min(initial=0)
    count = int(second.max(initial=0)) + 1
    counts = np.bincount(second[seen], minlength=count)
    averaging = np.zeros((len(second), count))
    averaging[seen, second[seen]] = 1.0 / counts[second[seen]]
    means = forward @ averaging
    valid = (counts[1:] > 0) & (counts[:-1] > 0)
    return np.where(valid, np.diff(means, axis=-1), 0.0)


def find_reproducible_frames(
    recordings: Sequence[Recording],
    perturbed: Sequence[FloatArray],
    config: IdentificationConfig = DEFAULT_CONFIG,
) -> tuple[list[BoolArray], float]:
    """The largest set of frames in which perturbed robots agree within `divergence_limit`.

    Returns whether each frame of each recording is kept, shapes (frames,), and the root mean square of the
    differences in the kept frames [m]. `perturbed` (n, frames, 2 markers): differences between the perturbed
    robots, as `Residual.shape` [m].
    """
    window = config.divergence_window
    squares = [
        _mean_square(r, x, r.tracked.times < r.start, window)
        for r, x in zip(recordings, perturbed, strict=True)
    ]
    every = np.sort(np.concatenate(squares))
    alike = np.cumsum(every) <= config.divergence_limit**2 * np.arange(1, len(every) + 1)
    most = every[alike].max(initial=0.0)
    kept = [s <= most for s in squares]
    again = [_mean_square(r, x, k, window)[k] for r, x, k in zip(recordings, perturbed, kept, strict=True)]
    return kept, root_mean(np.concatenate(again))


def mask_frames(recordings: Sequence[Recording], kept: Sequence[BoolArray]) -> list[Recording]:
    """The recordings as if no marker had been seen in frames that are not kept."""
    blind = [
        np.where(k[:, None, None], r.tracked.positions, np.nan) for r, k in zip(recordings, kept, strict=True)
    ]
    return [
        replace(r, tracked=replace(r.tracked, positions=x)) for r, x in zip(recordings, blind, strict=True)
    ]


def total_duration(recording: Recording, frames: BoolArray) -> float:
    """How long some of its frames last together [s]."""
    times = recording.tracked.times
    return float(frames.sum() * (times[-1] - times[0]) / (len(times) - 1))


def root_mean(squares: FloatArray) -> float:
    """Root of the mean of squares; 0 where there are none."""
    return float(np.sqrt(squares.sum() / max(squares.size, 1)))


def _mean_square(
    recording: Recording, perturbed: FloatArray, reference: BoolArray, window: float
) -> FloatArray:
    """Mean square by which perturbed robots differ within `window` [s] of each frame, from their means in the
    reference frames [m2], shape (frames,)."""
    seen = perturbed != 0
    counts = np.maximum(seen[:, reference].sum(axis=1, keepdims=True), 1)
    mean = perturbed[:, reference].sum(axis=1, keepdims=True) / counts
    squares = (np.where(seen, perturbed - mean, 0.0) ** 2).mean(axis=(0, 2))
    rate = 1 / total_duration(recording, np.arange(len(squares)) == 1)
    beside = np.ones(1 + 2 * round(window * rate))
    return np.convolve(squares, beside, "same") / np.convolve(np.ones(len(squares)), beside, "same")
