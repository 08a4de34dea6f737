"""How the predicted motion changes with every knob: the one place where a fit gets its derivatives from.

Central differences over a finite turn of each knob, all side by side in the engine's vector lanes. The
engine's own slopes (`eldir.built.sensitivities`) are exact, and grow without bound where feet strike the
ground: a landing's outcome hangs on the last micrometre, while the motion as a whole hardly changes. A fit
wants the latter: the slope over a turn that is wide against that (docs/decisions/0021-identification.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.dynamics.recording import Body, Recording, predict
from eldir.core.records import FloatArray
from eldir.parameters.robot import RobotParameters, robot_at
from eldir.parameters.uncertain import is_unobservable

_JITTER = 0.1  # of the turns, with which the motion is asked for once more
_REPEATS = 1  # with fifteen knobs turned to both sides, that fills four groups of the engine's lanes


@dataclass(frozen=True)
class Linear:
    """A motion and its slopes about a place."""

    positions: list[FloatArray]
    """Of each recording [m], shape (frames, marks, 2)."""
    slopes: list[FloatArray]
    """For each recording [m per standard deviation of the prior], shape (knobs, frames, marks, 2)."""
    repeats: list[FloatArray]
    """For each recording, how nearly equal robots differ from what the slopes say of them, by the chance
    of landings [m], shape (n, frames, marks, 2)."""


def linearise(
    body: Body,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    names: Sequence[str],
    z: FloatArray,
    turns: FloatArray,
) -> Linear:
    """About knobs turned by `z`, over a turn of `turns` to both sides, shapes (knobs,)."""
    loud = [j for j, name in enumerate(names) if not is_unobservable(name)]
    units = np.eye(len(z))[loud]
    sides = [
        z + sign * turn * unit for turn, unit in zip(turns[loud], units, strict=True) for sign in (1, -1)
    ]
    signs = np.random.default_rng(len(z)).choice([-1.0, 1.0], (_REPEATS, len(z)))
    jitter = _JITTER * signs * turns * units.sum(axis=0)
    tried = [robot_at(body.morphology, nominal, names, p) for p in [z, *(z + jitter), *sides]]
    motions = predict(body, recordings, tried)
    width = turns[loud, None, None, None]
    slopes = []
    for x in motions:
        here, above, below = x[:1], x[1 + _REPEATS :: 2], x[2 + _REPEATS :: 2]
        slope = (above - below) / (2 * width)
        # Where one side fell over, the other still tells.
        slope = np.where(np.isfinite(slope), slope, (above - here) / width)
        slope = np.where(np.isfinite(slope), slope, (here - below) / width)
        whole = np.zeros((len(z), *slope.shape[1:]))
        whole[loud] = np.nan_to_num(slope)
        slopes.append(whole)
    repeats = [
        np.nan_to_num(x[1 : 1 + _REPEATS] - x[0] - np.tensordot(jitter, whole, 1))
        for x, whole in zip(motions, slopes, strict=True)
    ]
    return Linear([x[0] for x in motions], slopes, repeats)
