"""Whether a model fits at all: what it leaves must be the camera's noise, which forgets from frame to frame.

Intervals say how well films fix a model's parameters, not whether it is the right model. Where it is not,
residuals are smooth: the mean product of neighbouring frames is the square of what no noise explains. It is
held against the noise of the tracks themselves (third differences, which know no model) and what landings
leave to chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.dynamics_residuals import misfit
from calibration.recording import Recording
from eldir.frozen import FloatArray, Record

_OF_NOISE = 0.3
"""Smooth residuals up to this part of the noise, and chance beside, are none."""
_LEAST = 0.02e-3  # what frames between instants and rounding may leave [m]
_WORST = 3  # motions that are named
_DIRECTIONS = ("forward", "up")


@dataclass(frozen=True, eq=False)
class Goodness(Record):
    """Of a prediction of some recordings."""

    marks: tuple[str, ...]
    smooth: FloatArray
    """What no noise explains of each mark, forward and up [m], shape (2, marks)."""
    noise: float
    """Of one coordinate in the tracks [m]."""
    left: float
    """Root mean square of all that is left [m]."""
    limit: float
    """Up to which `unexplained` is called none [m]."""

    @property
    def unexplained(self) -> float:
        """Root mean square over marks and directions [m]."""
        return float(np.sqrt((self.smooth**2).mean()))

    @property
    def fits(self) -> bool:
        """Whether nothing but noise and chance is left."""
        return self.unexplained <= self.limit

    def to_json(self) -> dict[str, Any]:
        """Plain values [m]."""
        return {
            "fits": self.fits,
            "unexplained_m": float(f"{self.unexplained:.4g}"),
            "limit_m": float(f"{self.limit:.4g}"),
            "noise_m": float(f"{self.noise:.4g}"),
            "marks": {
                mark: {d: float(f"{v:.4g}") for d, v in zip(_DIRECTIONS, self.smooth[:, i], strict=True)}
                for i, mark in enumerate(self.marks)
            },
        }


def goodness(
    recordings: Sequence[Recording], positions: Sequence[FloatArray], chance: float = 0.0
) -> Goodness:
    """Of predicted marks (frames, marks, 2) of each recording; robots nearly the same differ by `chance`."""
    products, pairs, squares = [], [], []
    for r, x in zip(recordings, positions, strict=True):
        left = misfit(r, np.nan_to_num(r.tracked.positions - x)).shape
        seen = left != 0
        products.append((left[1:] * left[:-1]).sum(axis=0))
        pairs.append((seen[1:] & seen[:-1]).sum(axis=0))
        squares.append(left[seen] ** 2)
    smooth = np.sqrt(np.maximum(sum(products), 0.0) / np.maximum(sum(pairs), 1))
    noise = float(np.median([track_noise(r) for r in recordings]))
    return Goodness(
        recordings[0].tracked.names,
        smooth.reshape(2, -1),
        noise,
        float(np.sqrt(np.concatenate(squares).mean())),
        max(_LEAST, _OF_NOISE * noise + chance),
    )


def track_noise(recording: Recording) -> float:
    """Standard deviation of one coordinate [m], from the middle size of third differences, in which motion
    that is smooth over four frames does not count. Of independent errors they have 20 times the variance."""
    x = recording.tracked.positions
    third = x[3:] - 3 * x[2:-1] + 3 * x[1:-2] - x[:-3]
    return float(1.4826 * np.nanmedian(np.abs(third)) / np.sqrt(20))


def in_words(model: dict[str, Any]) -> list[str]:
    """What a user has to know of the "model" of a built scene's results: which make was taken, and whether it
    fits."""
    said, (first, *more) = [], model["tried"]
    if more:
        extra = ", every strip and spring with turns of its own" if model["parts"] else ""
        said.append(
            f"{model['strips']} strips{extra}: held-out cycle {1e3 * model['held_out_left_m']:.2f} mm left, "
            f"{1e3 * first['held_out_left_m']:.2f} mm as {first['strips']} robot of like parts"
        )
    if model["fits"] and model["unexplained_m"] > model["noise_m"]:
        said.append(
            f"landings leave up to {1e3 * model['limit_m']:.2f} mm to chance, which hides whether the model "
            f"fits: {1e3 * model['unexplained_m']:.2f} mm are more than the camera's noise; film a gait that "
            "does not fall"
        )
    if model["fits"] and not model["supposed"]:
        said.append(
            f"{model['strips']} strips were chosen by the film: no value is called known; look at the robot, "
            "and measure the lengths by hand"
        )
    if not model["fits"]:
        every = [(v, f"{m} {d}") for m, both in model["marks"].items() for d, v in both.items()]
        worst = ", ".join(f"{name} {1e3 * v:.2f} mm" for v, name in sorted(every, reverse=True)[:_WORST])
        said.append(
            f"the model does not fit: {1e3 * model['unexplained_m']:.2f} mm that no noise explains, at most "
            f"{1e3 * model['limit_m']:.2f} expected, most in {worst}; no value is known, they mimic the "
            "motion: measure the lengths by hand"
        )
    return said
