"""The residuals of a model against the camera's noise: numbers from which a verdict follows.

Intervals say how well films determine a model's parameters, not whether it is the right model. The camera's
noise is independent from frame to frame; where a model is wrong, residuals are correlated. So the mean
product of neighbouring residuals is the square of what noise does not explain. It is compared with the noise
of the tracks themselves (from third differences, which need no model) and with what landings leave to chance.
Chance must not hide a wrong model: frames in which slightly perturbed robots diverge are left out
(`eldir_calibration.dynamics.least_squares.divergence`). `eldir_calibration.dynamics.verdict` decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eldir.core.records import BoolArray, FloatArray, Record
from eldir_calibration.dynamics.least_squares.divergence import (
    duration,
    reproducible_frames,
    root_of_mean,
    without,
)
from eldir_calibration.dynamics.least_squares.residuals import residual
from eldir_calibration.dynamics.recording import Recording
from eldir_calibration.dynamics.settings import DEFAULT_SETTINGS, IdentificationSettings

_DIRECTIONS = ("forward", "up")


@dataclass(frozen=True, eq=False)
class ModelCheck(Record):
    """Residuals of a prediction of some recordings."""

    marks: tuple[str, ...]
    smooth: FloatArray
    """Residual that noise does not explain, forward and up, of each mark [m], shape (2, marks)."""
    noise: float
    """Noise of one coordinate in the tracks [m]."""
    left: float
    """Root mean square of all residuals [m]."""
    limit: float
    """Largest `unexplained` that counts as none [m]."""
    motion: float
    """Motion of the marks about their means, root mean square [m]."""
    kept: tuple[BoolArray, ...]
    """The frames of each recording that were judged: perturbed robots agree there, shape (frames,)."""
    left_out: tuple[float, ...]
    """Duration of the part of each recording that was not judged [s]."""
    decided: bool = True
    """Whether enough frames were kept to judge."""

    @property
    def unexplained(self) -> float:
        """Residual that noise does not explain, root mean square over marks and directions [m]."""
        return float(np.sqrt((self.smooth**2).mean()))

    @property
    def share(self) -> float:
        """Part of all frames that was judged."""
        return float(np.concatenate(self.kept).mean())

    def entries(self) -> dict[str, Any]:
        """Its entries of `ModelNumbers`, rounded [m]."""
        return {
            "decided": self.decided,
            "left_out_s": tuple(_rounded(t) for t in self.left_out),
            "unexplained_m": _rounded(self.unexplained),
            "limit_m": _rounded(self.limit),
            "motion_m": _rounded(self.motion),
            "noise_m": _rounded(self.noise),
            "marks": {
                mark: {d: _rounded(v) for d, v in zip(_DIRECTIONS, self.smooth[:, i], strict=True)}
                for i, mark in enumerate(self.marks)
            },
        }


def check_model(
    recordings: Sequence[Recording],
    positions: Sequence[FloatArray],
    perturbed: Sequence[FloatArray] | None = None,
    *,
    settings: IdentificationSettings = DEFAULT_SETTINGS,
) -> ModelCheck:
    """Checks predicted marks (frames, marks, 2) [m] of each recording. `perturbed` (n, frames, 2 marks) [m]:
    by how much slightly perturbed robots differ, as `Residual.shape`; frames in which they diverge are not
    judged."""
    kept, chance = [np.ones(len(r.tracked.times), bool) for r in recordings], 0.0
    if perturbed is not None:
        kept, chance = reproducible_frames(recordings, perturbed, settings)
    products, pairs, squares, moved = [], [], [], []
    for r, x in zip(without(recordings, kept), positions, strict=True):
        left = residual(r, np.nan_to_num(r.tracked.positions - x)).shape
        seen = left != 0
        products.append((left[1:] * left[:-1]).sum(axis=0))
        pairs.append((seen[1:] & seen[:-1]).sum(axis=0))
        squares.append(left[seen] ** 2)
        moved.append(residual(r, np.nan_to_num(r.tracked.positions)).shape[seen])
    smooth = np.sqrt(np.maximum(sum(products), 0.0) / np.maximum(sum(pairs), 1))
    told = [n for n in map(track_noise, recordings) if np.isfinite(n)]
    noise = float(np.median(told)) if told else 0.0
    return ModelCheck(
        recordings[0].tracked.names,
        smooth.reshape(2, -1),
        noise,
        root_of_mean(np.concatenate(squares)),
        max(settings.least_limit, settings.noise_share * noise + chance),
        root_of_mean(np.concatenate(moved) ** 2),
        tuple(kept),
        tuple(duration(r, ~k) for r, k in zip(recordings, kept, strict=True)),
        any(
            duration(r, k & (r.tracked.times >= r.start)) >= settings.judged_share * r.period
            for r, k in zip(recordings, kept, strict=True)
        ),
    )


def track_noise(recording: Recording) -> float:
    """Standard deviation of one coordinate [m], from the median size of third differences, in which motion
    that is smooth over four frames cancels. Of independent errors they have 20 times the variance. NaN where
    no mark was seen in four frames in a row, as in a film of which landings leave nothing."""
    x = recording.tracked.positions
    third = x[3:] - 3 * x[2:-1] + 3 * x[1:-2] - x[:-3]
    seen = np.abs(third[np.isfinite(third)])
    return float(1.4826 * np.median(seen) / np.sqrt(20)) if len(seen) else np.nan


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
