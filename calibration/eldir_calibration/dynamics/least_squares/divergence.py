"""Frames in which slightly perturbed simulations diverge: there, chance decides what a tumbling robot does.

A landing goes one way or the other by the last micrometre. Mostly that does not matter: the perturbed robots
agree again within a second. Where one of them tumbles and another does not, they differ by millimetres, and
such frames say nothing about the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir_calibration.dynamics.recording import Recording
from eldir_calibration.dynamics.settings import DEFAULT_SETTINGS, IdentificationSettings


def reproducible_frames(
    recordings: Sequence[Recording],
    perturbed: Sequence[FloatArray],
    settings: IdentificationSettings = DEFAULT_SETTINGS,
) -> tuple[list[BoolArray], float]:
    """The largest set of frames in which perturbed robots agree within `divergence_limit`.

    Returns whether each frame of each recording is kept, shapes (frames,), and the root mean square of the
    differences in the kept frames [m]. `perturbed` (n, frames, 2 marks): differences between the perturbed
    robots, as `Residual.shape` [m].
    """
    window = settings.divergence_window
    squares = [
        _mean_square(r, x, r.tracked.times < r.start, window)
        for r, x in zip(recordings, perturbed, strict=True)
    ]
    every = np.sort(np.concatenate(squares))
    alike = np.cumsum(every) <= settings.divergence_limit**2 * np.arange(1, len(every) + 1)
    most = every[alike].max(initial=0.0)
    kept = [s <= most for s in squares]
    again = [_mean_square(r, x, k, window)[k] for r, x, k in zip(recordings, perturbed, kept, strict=True)]
    return kept, root_of_mean(np.concatenate(again))


def without(recordings: Sequence[Recording], kept: Sequence[BoolArray]) -> list[Recording]:
    """The recordings as if no mark had been seen in frames that are not kept."""
    blind = [
        np.where(k[:, None, None], r.tracked.positions, np.nan) for r, k in zip(recordings, kept, strict=True)
    ]
    return [
        replace(r, tracked=replace(r.tracked, positions=x)) for r, x in zip(recordings, blind, strict=True)
    ]


def duration(recording: Recording, frames: BoolArray) -> float:
    """How long some of its frames last together [s]."""
    times = recording.tracked.times
    return float(frames.sum() * (times[-1] - times[0]) / (len(times) - 1))


def root_of_mean(squares: FloatArray) -> float:
    """Root of the mean of squares; 0 where there are none."""
    return float(np.sqrt(squares.sum() / max(squares.size, 1)))


def _mean_square(
    recording: Recording, perturbed: FloatArray, reference: BoolArray, window: float
) -> FloatArray:
    """Mean square by which perturbed robots differ within `window` [s] of each frame, from their means in the
    reference frames [m2], shape (frames,)."""
    seen = perturbed != 0
    number = np.maximum(seen[:, reference].sum(axis=1, keepdims=True), 1)
    mean = perturbed[:, reference].sum(axis=1, keepdims=True) / number
    squares = (np.where(seen, perturbed - mean, 0.0) ** 2).mean(axis=(0, 2))
    rate = 1 / duration(recording, np.arange(len(squares)) == 1)
    beside = np.ones(1 + 2 * round(window * rate))
    return np.convolve(squares, beside, "same") / np.convolve(np.ones(len(squares)), beside, "same")
