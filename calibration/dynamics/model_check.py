"""Whether a model fits at all: what it leaves must be the camera's noise, which forgets from frame to frame.

Intervals say how well films fix a model's parameters, not whether it is the right model. Where it is not,
residuals are smooth: the mean product of neighbouring frames is the square of what no noise explains. It is
held against the noise of the tracks themselves (third differences, which know no model) and what landings
leave to chance. That must not hide a misfit: frames in which robots nearly the same part are left out
(`calibration.dynamics.divergence`), and where they are too many nothing can be told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.dynamics.divergence import lasting, root_mean, together, without
from calibration.dynamics.recording import Recording
from calibration.dynamics.residuals import misfit
from eldir.core.records import BoolArray, FloatArray, Record

_OF_NOISE = 0.3
"""Smooth residuals up to this part of the noise, and chance beside, are none."""
_LEAST = 0.02e-3  # what frames between instants and rounding may leave [m]
_CLOSE = 0.02
"""Of the motion: a model of every part that leaves no more is nearly right (decision 0025)."""
_ENOUGH = 0.9  # of a cycle has to be kept
_TOLD = 5.0  # a single landing that chance decides is not worth a word [s]
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
    motion: float
    """Of the marks, about their means: root mean square [m]."""
    kept: tuple[BoolArray, ...]
    """Of each recording, the frames that were judged: robots nearly the same do alike, shape (frames,)."""
    left_out: tuple[float, ...]
    """How much of each recording was not [s]."""
    decided: bool = True
    """Whether enough was kept to judge."""

    @property
    def unexplained(self) -> float:
        """Root mean square over marks and directions [m]."""
        return float(np.sqrt((self.smooth**2).mean()))

    @property
    def fits(self) -> bool:
        """Whether nothing but noise and chance is left; not where chance hides it."""
        return self.decided and self.unexplained <= self.limit

    @property
    def tolerable(self) -> float:
        """Up to which a model with turns for every part may leave something [m]."""
        return max(self.limit, _CLOSE * self.motion)

    def to_json(self) -> dict[str, Any]:
        """Plain values [m]."""
        return {
            "fits": self.fits,
            "decided": self.decided,
            "left_out_s": [float(f"{t:.4g}") for t in self.left_out],
            "unexplained_m": float(f"{self.unexplained:.4g}"),
            "limit_m": float(f"{self.limit:.4g}"),
            "motion_m": float(f"{self.motion:.4g}"),
            "noise_m": float(f"{self.noise:.4g}"),
            "marks": {
                mark: {d: float(f"{v:.4g}") for d, v in zip(_DIRECTIONS, self.smooth[:, i], strict=True)}
                for i, mark in enumerate(self.marks)
            },
        }


def goodness(
    recordings: Sequence[Recording],
    positions: Sequence[FloatArray],
    nearly: Sequence[FloatArray] | None = None,
) -> Goodness:
    """Of predicted marks (frames, marks, 2) of each recording. `nearly` (n, frames, 2 marks): by how much
    robots nearly the same differ, as `Misfit.shape`; frames in which they part are not judged."""
    kept, chance = [np.ones(len(r.tracked.times), bool) for r in recordings], 0.0
    if nearly is not None:
        kept, chance = together(recordings, nearly)
    products, pairs, squares, moved = [], [], [], []
    for r, x in zip(without(recordings, kept), positions, strict=True):
        left = misfit(r, np.nan_to_num(r.tracked.positions - x)).shape
        seen = left != 0
        products.append((left[1:] * left[:-1]).sum(axis=0))
        pairs.append((seen[1:] & seen[:-1]).sum(axis=0))
        squares.append(left[seen] ** 2)
        moved.append(misfit(r, np.nan_to_num(r.tracked.positions)).shape[seen])
    smooth = np.sqrt(np.maximum(sum(products), 0.0) / np.maximum(sum(pairs), 1))
    noise = float(np.median([track_noise(r) for r in recordings]))
    return Goodness(
        recordings[0].tracked.names,
        smooth.reshape(2, -1),
        noise,
        root_mean(np.concatenate(squares)),
        max(_LEAST, _OF_NOISE * noise + chance),
        root_mean(np.concatenate(moved) ** 2),
        tuple(kept),
        tuple(lasting(r, ~k) for r, k in zip(recordings, kept, strict=True)),
        any(
            lasting(r, k & (r.tracked.times >= r.start)) >= _ENOUGH * r.period
            for r, k in zip(recordings, kept, strict=True)
        ),
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
    left_out = [f"{t:.0f} s of film {i + 1}" for i, t in enumerate(model["left_out_s"]) if t > _TOLD]
    if left_out:
        said.append(f"landings decide what the robot does in {' and '.join(left_out)}, which were left out")
    if model["fits"] and model["unexplained_m"] > model["limit_m"]:
        said.append(
            f"the model is nearly right: {1e3 * model['unexplained_m']:.2f} mm that no noise explains, "
            f"{model['unexplained_m'] / model['motion_m']:.1%} of the motion; intervals are twice as wide"
        )
    if model["fits"] and not model["supposed"]:
        said.append(
            f"{model['strips']} strips were chosen by the film: no value is called known; look at the robot, "
            "and measure the lengths by hand"
        )
    if not model["decided"]:
        said.append(
            "too little is left to tell whether the model fits: no value is known; film a gait that does "
            "not fall"
        )
    if model["strained"]:
        said.append(
            f"{', '.join(model['strained'])} had to be turned as far as a prior allows, which stands in for "
            "something else: no value is known"
        )
    if model["decided"] and not model["predicts"]:
        every = [(v, f"{m} {d}") for m, both in model["marks"].items() for d, v in both.items()]
        worst = ", ".join(f"{name} {1e3 * v:.2f} mm" for v, name in sorted(every, reverse=True)[:_WORST])
        said.append(
            f"the model does not fit: {1e3 * model['unexplained_m']:.2f} mm that no noise explains, at most "
            f"{1e3 * model['limit_m']:.2f} expected, most in {worst}; no value is known, they mimic the "
            "motion: measure the lengths by hand"
        )
    return said
