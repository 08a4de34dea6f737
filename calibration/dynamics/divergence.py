"""Where robots nearly the same part: what a tumbling robot does is decided by chance, and tells nothing.

A landing goes one way or the other by the last micrometre, and mostly it does not matter: the robots are
together again within a second. Where one tumbles and its neighbour does not, millimetres hang on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.dynamics.recording import Recording
from eldir.core.records import BoolArray, FloatArray

_PARTED = 0.1e-3  # by which robots nearly the same may differ; strips 0.3 mm off leave 0.13 mm [m]
_BESIDE = 0.5  # to both sides of a frame, over which they are compared [s]


def together(recordings: Sequence[Recording], nearly: Sequence[FloatArray]) -> tuple[list[BoolArray], float]:
    """As many frames of each recording as leave robots nearly the same within `_PARTED` of each other, the
    most different ones left out, and by how much they differ in these (root mean square [m]).

    `nearly` (n, frames, 2 marks): by how much they differ, as `Misfit.shape`.
    """
    squares = [_apart(r, x, r.tracked.times < r.start) for r, x in zip(recordings, nearly, strict=True)]
    every = np.sort(np.concatenate(squares))
    alike = np.cumsum(every) <= _PARTED**2 * np.arange(1, len(every) + 1)
    most = every[alike].max(initial=0.0)
    kept = [s <= most for s in squares]
    again = [_apart(r, x, k)[k] for r, x, k in zip(recordings, nearly, kept, strict=True)]
    return kept, root_mean(np.concatenate(again))


def without(recordings: Sequence[Recording], kept: Sequence[BoolArray]) -> list[Recording]:
    """The recordings as if no mark had been seen in frames that are not kept."""
    blind = [
        np.where(k[:, None, None], r.tracked.positions, np.nan) for r, k in zip(recordings, kept, strict=True)
    ]
    return [
        replace(r, tracked=replace(r.tracked, positions=x)) for r, x in zip(recordings, blind, strict=True)
    ]


def lasting(recording: Recording, frames: BoolArray) -> float:
    """How long some of its frames last [s]."""
    times = recording.tracked.times
    return float(frames.sum() * (times[-1] - times[0]) / (len(times) - 1))


def root_mean(squares: FloatArray) -> float:
    """0 of nothing."""
    return float(np.sqrt(squares.sum() / max(squares.size, 1)))


def _apart(recording: Recording, nearly: FloatArray, reference: BoolArray) -> FloatArray:
    """Mean square by which robots differ beside each frame, from their means in the frames of reference [m2],
    shape (frames,)."""
    seen = nearly != 0
    number = np.maximum(seen[:, reference].sum(axis=1, keepdims=True), 1)
    mean = nearly[:, reference].sum(axis=1, keepdims=True) / number
    squares = (np.where(seen, nearly - mean, 0.0) ** 2).mean(axis=(0, 2))
    rate = 1 / lasting(recording, np.arange(len(squares)) == 1)
    beside = np.ones(1 + 2 * round(_BESIDE * rate))
    return np.convolve(squares, beside, "same") / np.convolve(np.ones(len(squares)), beside, "same")
