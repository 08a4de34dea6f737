"""Which knob explains which millimetre, and which gait would tell most if it were filmed next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.dynamics.linearisation import linearise
from calibration.dynamics.recording import INTERVAL, Body, Recording, predict
from calibration.dynamics.residuals import misfit
from eldir.built.gait import SETTLE, Gait
from eldir.built.scene import BuiltScene
from eldir.core.records import FloatArray, Record
from eldir.parameters.robot import RobotParameters
from eldir.trajectory import Trajectory

_TURN = 0.3  # of a standard deviation of the prior, to both sides
_RATE = 10.0  # frames a second of the film that is imagined


@dataclass(frozen=True, eq=False)
class Explained(Record):
    """Vertical ranges of motion in a recording's last cycle, and what turns them."""

    knobs: tuple[str, ...]
    marks: tuple[str, ...]
    slopes: FloatArray
    """Change of a mark's range per standard deviation of the knob's prior [m], shape (knobs, marks)."""
    shares: FloatArray
    """Of a mark's range with the knob, per standard deviation of its prior [m], shape (knobs, marks)."""
    change: FloatArray
    """That change [m], shape (marks,)."""

    def to_json(self) -> dict[str, Any]:
        """Plain values, in metres."""

        def named(values: FloatArray) -> dict[str, float]:
            return {m: round(float(v), 7) for m, v in zip(self.marks, values, strict=True)}

        return {
            "vertical_range_m_per_prior_deviation": {
                n: named(v) for n, v in zip(self.knobs, self.slopes, strict=True)
            },
            "vertical_range_m_from_nominal": {
                n: named(v) for n, v in zip(self.knobs, self.shares, strict=True)
            }
            | {"all": named(self.change)},
        }


def explain(body: Body, recording: Recording, nominal: RobotParameters, scene: BuiltScene) -> Explained:
    """Slopes at both robots, each knob's share by their mean; what the shares leave is not linear."""
    names = scene.parameters
    z = scene.z
    places = [np.zeros(len(z)), z]
    steps = [s * _TURN * unit for unit in np.eye(len(z)) for s in (1, -1)]
    tried = [nominal.at(names, p) for place in places for p in [place, *(place + s for s in steps)]]
    (motions,) = predict(body, [recording], tried)
    t = recording.tracked.times
    last = (t >= recording.end - recording.period) & (t <= recording.end)
    ranges = np.ptp(motions[..., 1][:, last], axis=1).reshape(2, -1, len(body.marks))
    slopes = np.nan_to_num((ranges[:, 1::2] - ranges[:, 2::2]) / (2 * _TURN))
    return Explained(
        names,
        recording.tracked.names,
        slopes[1],
        slopes.mean(axis=0) * z[:, None],
        ranges[1, 0] - ranges[0, 0],
    )


@dataclass(frozen=True)
class Experiment:
    """A film of one gait, imagined."""

    gait: Gait
    information: float
    """By how much it would shrink the volume of what is not known: logarithm to base 2 [bit]."""
    doubts: dict[str, float]
    """Standard deviation that each knob would be left with, as a part of its prior's."""

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "phase": [round(float(p), 6) for p in self.gait.phase],
            "information_bit": round(self.information, 3),
            "doubt_left_of_prior": {n: round(d, 4) for n, d in self.doubts.items()},
        }


def experiments(body: Body, scene: BuiltScene, gaits: Sequence[Gait], cycles: int = 1) -> list[Experiment]:
    """What a film of each gait is expected to add to what the scene knows, the most telling first.

    To first order about the identified robot: the covariance becomes (C^-1 + J'J)^-1 with J in standard
    deviations of what the fit counted as noise.
    """
    found, told = [], scene.results["noise_m"]
    noise = told["shape"], told["walk_per_second"]
    zero = np.zeros(len(scene.parameters))
    prior = np.linalg.pinv(scene.covariance, hermitian=True)
    for gait in gaits:
        film = _imagined(body, gait, cycles)
        turns = np.full(len(zero), _TURN)
        linear = linearise(body, [film], scene.robot.uniform, scene.parameters, zero, turns)
        rows = misfit(film, linear.slopes[0]).scaled(*noise)
        after = np.linalg.inv(prior + rows @ rows.T)
        gain = 0.5 * (np.linalg.slogdet(prior + rows @ rows.T)[1] - np.linalg.slogdet(prior)[1]) / np.log(2)
        doubts = dict(zip(scene.parameters, np.sqrt(np.diag(after)).tolist(), strict=True))
        found.append(Experiment(gait, float(gain), doubts))
    return sorted(found, key=lambda e: -e.information)


def _imagined(body: Body, gait: Gait, cycles: int) -> Recording:
    """A recording of nothing yet, in which every mark is always seen."""
    starts = np.arange(round((SETTLE + gait.period * (1 + cycles)) / INTERVAL)) * INTERVAL
    times = np.arange(0, len(starts) * INTERVAL, 1 / _RATE)
    names = tuple(f"m{i + 1}" for i in range(len(body.marks)))
    nothing = Trajectory(names, times, np.zeros((len(times), len(names), 2)))
    on = gait.on(starts - SETTLE + 1e-9).astype(float)
    return Recording(nothing, on, SETTLE + gait.period, gait.period, cycles)
