"""How the predicted motion changes with every parameter: the one place where a fit gets its derivatives from.

Central differences over a finite step of each parameter, all side by side in the engine's vector lanes. The
engine's own slopes (`eldir.built.sensitivities`) are exact, but grow without bound where feet strike the
ground: a landing's outcome depends on the last micrometre, while the motion as a whole hardly changes. A fit
needs the slope of the whole motion, over a step that is wide against that
(docs/decisions/0021-identification.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldir.core.records import FloatArray
from eldir.parameters.robot import RobotParameters, robot_at
from eldir.parameters.uncertain import is_unobservable
from eldir_calibration.dynamics.recording import FilmedBody, Recording, predict_marks
from eldir_calibration.dynamics.settings import DEFAULT_SETTINGS, IdentificationSettings


@dataclass(frozen=True)
class Linearisation:
    """A predicted motion and its slopes at one place."""

    positions: list[FloatArray]
    """Marks in each recording [m], shape (frames, marks, 2)."""
    slopes: list[FloatArray]
    """Slopes for each recording [m per standard deviation of the prior],
    shape (parameters, frames, marks, 2)."""
    repeats: list[FloatArray]
    """Deviation of slightly perturbed robots from the slopes' prediction in each recording, by the chance of
    landings [m], shape (n, frames, marks, 2)."""


def linearise(
    body: FilmedBody,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    names: Sequence[str],
    z: FloatArray,
    step_widths: FloatArray,
    settings: IdentificationSettings = DEFAULT_SETTINGS,
) -> Linearisation:
    """Linearisation at normalised values `z`, over `step_widths` to both sides, shapes (parameters,)."""
    loud = [j for j, name in enumerate(names) if not is_unobservable(name)]
    units = np.eye(len(z))[loud]
    sides = [
        z + sign * width * unit
        for width, unit in zip(step_widths[loud], units, strict=True)
        for sign in (1, -1)
    ]
    repeats = settings.repeats
    signs = np.random.default_rng(len(z)).choice([-1.0, 1.0], (repeats, len(z)))
    jitter = settings.jitter * signs * step_widths * units.sum(axis=0)
    tried = [robot_at(body.morphology, nominal, names, p) for p in [z, *(z + jitter), *sides]]
    motions = predict_marks(body, recordings, tried)
    width = step_widths[loud, None, None, None]
    slopes = []
    for x in motions:
        here, above, below = x[:1], x[1 + repeats :: 2], x[2 + repeats :: 2]
        slope = (above - below) / (2 * width)
        # Where one side fell over, the other side still has a slope.
        slope = np.where(np.isfinite(slope), slope, (above - here) / width)
        slope = np.where(np.isfinite(slope), slope, (here - below) / width)
        whole = np.zeros((len(z), *slope.shape[1:]))
        whole[loud] = np.nan_to_num(slope)
        slopes.append(whole)
    chance = [
        np.nan_to_num(x[1 : 1 + repeats] - x[0] - np.tensordot(jitter, whole, 1))
        for x, whole in zip(motions, slopes, strict=True)
    ]
    return Linearisation([x[0] for x in motions], slopes, chance)
