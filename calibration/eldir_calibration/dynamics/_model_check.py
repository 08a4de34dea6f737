"""The residuals of a model against the camera's noise: numbers from which a verdict follows.

Intervals say how well films determine a model's parameters, not whether it is the right model. The camera's
noise is independent from frame to frame; where a model is wrong, residuals are correlated. So the mean
product of neighbouring residuals is the square of what noise does not explain. It is compared with the noise
of the tracks themselves (from third differences, which need no model) and with the divergence of landings.
Divergence must not hide a wrong model: frames in which slightly perturbed robots diverge are excluded
(`eldir_calibration.dynamics._problem`). `eldir_calibration.dynamics.verdict` decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from eldir.built.gait import CYCLES
from eldir.core.records import BoolArray, FloatArray, Record
from eldir.trajectory import MAX_TIME_GAP, height_ranges, interpolate_near, mean_known
from eldir_calibration.dynamics._problem import (
    compute_residual,
    find_reproducible_frames,
    mask_frames,
    root_mean,
    total_duration,
)
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig
from eldir_calibration.dynamics.recording import Recording

_DIRECTIONS = ("forward", "up")
_NOISE_SAMPLES = 20


@dataclass(frozen=True, eq=False)
class ModelCheck(Record):
    """Residuals of a prediction of some recordings."""

    markers: tuple[str, ...]
    correlated: FloatArray
    """Residual that noise does not explain, forward and up, of each marker [m], shape (2, markers); NaN for a
    marker that was not seen in two frames in a row."""
    noise: float
    """Noise of one coordinate in the tracks [m]."""
    rms: float
    """Root mean square of all residuals [m]."""
    limit: float
    """Largest `unexplained` that counts as none [m]."""
    motion: float
    """Motion of the markers about their means, root mean square [m]."""
    reproducible: tuple[BoolArray, ...]
    """The frames of each recording that were judged: perturbed robots agree there, shape (frames,)."""
    excluded_s: tuple[float, ...]
    """Duration of the part of each recording that was not judged [s]."""
    is_decidable: bool = True
    """Whether enough frames were kept to judge."""

    @property
    def unexplained(self) -> float:
        """Residual that noise does not explain, root mean square over seen markers and directions [m]; 0
        without any."""
        return root_mean(self.correlated[np.isfinite(self.correlated)] ** 2)

    @property
    def reproducible_share(self) -> float:
        """Part of all frames that was judged."""
        return float(np.concatenate(self.reproducible).mean())

    def entries(self) -> dict[str, Any]:
        """Its entries of `ModelNumbers`, rounded [m]."""
        return {
            "decided": self.is_decidable,
            "left_out_s": tuple(_rounded(t) for t in self.excluded_s),
            "unexplained_m": _rounded(self.unexplained),
            "limit_m": _rounded(self.limit),
            "motion_m": _rounded(self.motion),
            "noise_m": _rounded(self.noise),
            "marks": {
                marker: {d: _rounded(v) for d, v in zip(_DIRECTIONS, self.correlated[:, i], strict=True)}
                for i, marker in enumerate(self.markers)
                if np.isfinite(self.correlated[:, i]).all()
            },
        }


def check_model(
    recordings: Sequence[Recording],
    positions: Sequence[FloatArray],
    perturbed: Sequence[FloatArray] | None = None,
    *,
    config: IdentificationConfig = DEFAULT_CONFIG,
) -> ModelCheck:
    """Checks predicted markers (frames, markers, 2) [m] of each recording. `perturbed` (n, frames, 2 markers)
    [m]: by how much slightly perturbed robots differ, as `Residual.shape`; frames in which they diverge are
    not judged. Where the camera saw a marker and the predicted robot blew up, the residual is huge."""
    reproducible, chance = [np.ones(len(r.tracked.times), bool) for r in recordings], 0.0
    if perturbed is not None:
        reproducible, chance = find_reproducible_frames(recordings, perturbed, config)
    products, pairs, squares, motions = [], [], [], []
    for r, x in zip(mask_frames(recordings, reproducible), positions, strict=True):
        residuals = compute_residual(r, np.nan_to_num(r.tracked.positions - x)).shape
        visible = np.tile(np.isfinite(r.tracked.positions[..., 0]), 2)
        diverged = visible & ~np.tile(np.isfinite(x).all(axis=-1), 2)
        residuals = np.where(diverged, config.diverged_residual * config.camera_noise, residuals)
        products.append((residuals[1:] * residuals[:-1]).sum(axis=0))
        pairs.append((visible[1:] & visible[:-1]).sum(axis=0))
        squares.append(residuals[visible] ** 2)
        motions.append(compute_residual(r, np.nan_to_num(r.tracked.positions)).shape[visible])
    count = sum(pairs)
    correlated = np.sqrt(np.maximum(sum(products), 0.0) / np.maximum(count, 1))
    noises = [n for n in map(track_noise, recordings) if np.isfinite(n)]
    noise = float(np.median(noises)) if noises else 0.0
    return ModelCheck(
        recordings[0].tracked.names,
        np.where(count > 0, correlated, np.nan).reshape(2, -1),
        noise,
        root_mean(np.concatenate(squares)),
        max(config.min_limit, config.noise_share * noise + chance),
        root_mean(np.concatenate(motions) ** 2),
        tuple(reproducible),
        tuple(total_duration(r, ~k) for r, k in zip(recordings, reproducible, strict=True)),
        any(
            total_duration(r, k & (r.tracked.times >= r.start)) >= config.min_judged_share * r.period
            for r, k in zip(recordings, reproducible, strict=True)
        ),
    )


def track_noise(recording: Recording) -> float:
    """Standard deviation of one coordinate [m], from the median size of third differences, in which motion
    that is smooth over four frames cancels. Of independent errors they have 20 times the variance. NaN where
    no marker was seen in four frames in a row, as in a film with contact-sensitive frames only."""
    x = recording.tracked.positions
    third = x[3:] - 3 * x[2:-1] + 3 * x[1:-2] - x[:-3]
    visible = np.abs(third[np.isfinite(third)])
    return float(1.4826 * np.median(visible) / np.sqrt(20)) if len(visible) else np.nan


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


@dataclass(frozen=True, eq=False)
class CycleMotions(Record):
    """Motion of the K markers in each of the C cycles of a recording that count."""

    ranges: FloatArray
    """Greatest minus least height [m], shape (C, K); NaN for a marker that was not seen."""
    walks: FloatArray
    """Mean forward motion of the markers that were seen at both ends of the cycle [m], shape (C,); NaN where
    none was."""

    @classmethod
    def of(cls, recording: Recording, positions: FloatArray) -> CycleMotions:
        """Motion in each cycle of markers at `positions` [m] in the recording's frames, shape (frames, K, 2).
        Only frames count in which the camera saw the marker."""
        t = recording.tracked.times
        x = np.where(np.isfinite(recording.tracked.positions), positions, np.nan)
        ends = recording.start + recording.period * np.arange(recording.cycles + 1)
        inside = [(t >= a) & (t <= b) for a, b in pairwise(ends)]
        ranges = np.array([height_ranges(x[frames, :, 1]) for frames in inside])
        positions_at_ends = interpolate_near(t, x[..., 0], ends, MAX_TIME_GAP * recording.period)
        return cls(ranges, mean_known(np.diff(positions_at_ends, axis=0), axis=1))

    def without_noise(self, recording: Recording, predicted: FloatArray) -> CycleMotions:
        """The filmed ranges less what the tracks' noise adds to those of a motion like them (`predicted`, as
        in `of`).

        Greatest minus least of some hundred noisy heights is too large by several standard deviations of the
        noise: of a marker that rests, the range is nothing else.
        """
        rng, noise = np.random.default_rng(0), track_noise(recording)
        samples = [
            CycleMotions.of(recording, predicted + noise * rng.standard_normal(predicted.shape)).ranges
            for _ in range(_NOISE_SAMPLES)
        ]
        added = np.mean(samples, axis=0) - CycleMotions.of(recording, predicted).ranges
        return replace(self, ranges=np.maximum(self.ranges - np.nan_to_num(added), 0.0))

    def range_errors(self, predicted: CycleMotions) -> FloatArray:
        """Mean error of the predicted ranges in each cycle, relative to the filmed mean range, shape (C,);
        NaN where no marker was seen. A prediction that has no range, as it blew up, counts as 0."""
        errors = np.nansum(np.abs(np.nan_to_num(predicted.ranges) - self.ranges), axis=1)
        whole = np.nansum(self.ranges, axis=1)
        return np.divide(errors, whole, out=np.full(len(errors), np.nan), where=whole > 0)

    def per_five_cycles(self, body_length: float) -> FloatArray:
        """Walk in each cycle in body lengths per five cycles, shape (C,). `body_length` [m]."""
        return self.walks / body_length * CYCLES
