"""How well a prediction meets the camera in each cycle: vertical ranges of the marks, and the walk.

The errors in the cycles that were fitted are known before the held-out cycle is looked at. A model that lacks
something of the robot will be off by as much, or more, in a cycle that it has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from eldir.core.records import FloatArray, Record
from eldir_calibration.dynamics.model_check import track_noise
from eldir_calibration.dynamics.recording import Recording

_COUNTED = 5
"""Walks are given for so many cycles (paper, Sect. Sim2Real)."""
_DRAWS = 20
_NEAR = 0.1  # of a period: a mark that was seen so near to an instant has a place there


@dataclass(frozen=True, eq=False)
class Cycles(Record):
    """Motion of the K marks in each of the C cycles of a recording that count."""

    ranges: FloatArray
    """Greatest minus least height [m], shape (C, K); NaN for a mark that was not seen."""
    walks: FloatArray
    """Mean forward motion of the marks that were seen at both ends of the cycle [m], shape (C,); NaN where
    none was."""

    @classmethod
    def of(cls, recording: Recording, positions: FloatArray) -> Cycles:
        """Of marks at the recording's frames [m], shape (frames, K, 2). Only frames count in which the camera
        saw the mark."""
        t = recording.tracked.times
        x = np.where(np.isfinite(recording.tracked.positions), positions, np.nan)
        ends = recording.start + recording.period * np.arange(recording.cycles + 1)
        inside = [(t >= a) & (t <= b) for a, b in pairwise(ends)]
        ranges = np.array([_ranges(x[frames, :, 1]) for frames in inside])
        places = _places(t, x[..., 0], ends, _NEAR * recording.period)
        return cls(ranges, _mean(np.diff(places, axis=0)))

    def without_noise(self, recording: Recording, predicted: FloatArray) -> Cycles:
        """The filmed ranges less what the tracks' noise adds to those of a motion like them (`predicted`, as
        in `of`).

        Greatest minus least of some hundred noisy heights is too large by several standard deviations of the
        noise: of a mark that rests, the range is nothing else.
        """
        rng, noise = np.random.default_rng(0), track_noise(recording)
        draws = [
            Cycles.of(recording, predicted + noise * rng.standard_normal(predicted.shape)).ranges
            for _ in range(_DRAWS)
        ]
        added = np.mean(draws, axis=0) - Cycles.of(recording, predicted).ranges
        return replace(self, ranges=np.maximum(self.ranges - np.nan_to_num(added), 0.0))

    def range_errors(self, predicted: Cycles) -> FloatArray:
        """Mean error of the predicted ranges in each cycle, relative to the filmed mean range, shape (C,);
        NaN where no mark was seen. A prediction that has no range, as it blew up, counts as 0."""
        off = np.nansum(np.abs(np.nan_to_num(predicted.ranges) - self.ranges), axis=1)
        whole = np.nansum(self.ranges, axis=1)
        return np.divide(off, whole, out=np.full(len(off), np.nan), where=whole > 0)

    def per_five_cycles(self, body_length: float) -> FloatArray:
        """Walk in each cycle in body lengths per five cycles, shape (C,). `body_length` [m]."""
        return self.walks / body_length * _COUNTED


def _ranges(heights: FloatArray) -> FloatArray:
    found = np.full(heights.shape[1], np.nan)
    some = np.isfinite(heights).any(axis=0)
    found[some] = np.nanmax(heights[:, some], axis=0) - np.nanmin(heights[:, some], axis=0)
    return found


def _places(times: FloatArray, forward: FloatArray, instants: FloatArray, reach: float) -> FloatArray:
    """Places of the marks at some instants [m], shape (instants, K); NaN for a mark that was not seen within
    `reach` [s] of the instant."""
    found = np.full((len(instants), forward.shape[1]), np.nan)
    for k, x in enumerate(forward.T):
        seen = np.isfinite(x)
        if seen.any():
            near = np.abs(times[seen][:, None] - instants).min(axis=0) <= reach
            found[near, k] = np.interp(instants[near], times[seen], x[seen])
    return found


def _mean(moved: FloatArray) -> FloatArray:
    """Mean over the marks that were seen, shape (C,)."""
    seen = np.isfinite(moved)
    number = seen.sum(axis=1)
    total = np.where(seen, moved, 0.0).sum(axis=1)
    return np.divide(total, number, out=np.full(len(moved), np.nan), where=number > 0)
