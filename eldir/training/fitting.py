"""Gradients of a motion with respect to everything it comes from, and fitting a robot's physics to a motion
that was observed.

The engine's reverse sweep gives them all at once: the loss, or any function of the positions, costs one more
simulation however many springs and masses a robot has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from eldir.controller import Controller
from eldir.core.records import BoolArray, FloatArray, Record
from eldir.engine.stable_step import divided
from eldir.errors import InputError
from eldir.morphology import Morphology
from eldir.physics import GRIPPING, Physics, physics_of
from eldir.rollout import by_substeps, check, chosen_of, fitting_memory, simulate
from eldir.scene import Scene

KNOBS = (
    "stiffness",
    "passive stiffness",
    "active stiffness",
    "rest lengths",
    "damping",
    "gravity",
    "friction",
)
"""What can be fitted: each a factor on what the robot has to begin with."""
_FACTORS = (0.1, 10.0)  # between these a fit looks
_STEP = 1e-4  # of a logarithm, for standard errors
_NOTHING = 1e-6  # of the strongest: what a motion does not tell
_FAR = 1e6  # mean square distance of a robot that blew up [m2]
_SMALL = 1e-14  # a gain of this part of the first sum of squares ends it


@dataclass(frozen=True, eq=False)
class Gradients(Record):
    """Of each robot."""

    losses: FloatArray
    """[m], shape (n,); infinite for a robot that blew up or was refused, whose gradients are zero."""
    controllers: tuple[Controller, ...]
    physics: tuple[Physics, ...]
    """Per unit of each parameter."""


@dataclass(frozen=True, eq=False)
class Fit(Record):
    physics: Physics
    factors: FloatArray
    """Of each knob, shape (K,)."""
    errors: FloatArray
    """Their relative standard errors, shape (K,), as the noise that is left and the slopes of the motion
    tell; infinite where the motion does not depend on a knob."""
    distance: float
    """Root mean square from the observed positions [m]."""


def gradients(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
    pulls: Sequence[FloatArray] | None = None,
) -> Gradients:
    """Of the loss with respect to the controllers and to physics; with `pulls`, (T + 1, M, 2) for each robot,
    of the sum of `simulate`'s positions times them: pulls that are the derivatives of a function with respect
    to the positions give that function's gradient.
    """
    from eldir.engine import batch

    scene.require_controller()
    check(morphologies, controllers)
    owns = physics_of(morphologies, scene, physics)
    _check_pulls(morphologies, scene, pulls)
    losses = np.full(len(morphologies), np.inf)
    slopes = [b.scaled(0.0) for b in controllers]
    physical = [own.scaled(0.0) for own in owns]
    for parts, chosen in by_substeps(morphologies, scene, owns):
        finer = divided(scene, parts)
        bodies, brains, own = chosen_of(chosen, morphologies, controllers, owns)
        for part in fitting_memory(bodies, finer.steps):
            here = chosen[part]
            pulled = None if pulls is None else [_between(pulls[i], parts) for i in here]
            outcome = batch.run_batch(
                bodies[part], brains[part], finer, own[part], backward=True, physical=True, cotangents=pulled
            )
            losses[here] = outcome.losses[:, 0]
            taught = outcome.batch.controllers(outcome.best)
            for i, weights, found in zip(here, taught, outcome.physics, strict=True):
                slopes[i], physical[i] = weights, found
    return Gradients(losses, tuple(slopes), tuple(physical))


def fit(
    morphology: Morphology,
    controller: Controller,
    scene: Scene,
    observed: FloatArray,
    knobs: Sequence[str],
    start: Physics | None = None,
) -> Fit:
    """The factors on `start` with which the robot moves most nearly as it was observed to: positions [m],
    shape (T + 1, M, 2), NaN where a mass was not seen. By L-BFGS on the logarithms of the factors.

    It finds the nearest minimum. Chaos makes others where motions are long: fit short ones, in float64.
    """
    _check_knobs(knobs, scene)
    seen = np.isfinite(observed)
    shape = (scene.steps + 1, *morphology.positions.shape)
    if observed.shape != shape or not seen.any():
        raise InputError("the observed positions are wrong", expected=f"{shape}, some of them finite",
                         found=f"{observed.shape}, {int(seen.sum())} finite")  # fmt: skip
    scene = scene.replace(large_step="subdivide")
    first = start if start is not None else Physics.of(morphology, scene)
    parts = [_part(morphology, knob) for knob in knobs]

    def turned(logarithms: FloatArray) -> Physics:
        own = first
        for (name, which), factor in zip(parts, np.exp(logarithms), strict=True):
            value = getattr(own, name)
            own = own.replace(
                **{name: value * np.where(which, factor, 1.0) if np.ndim(value) else value * factor}
            )
        return own

    def squares(logarithms: FloatArray) -> tuple[float, FloatArray]:
        """Mean square distance [m2] and its gradient."""
        own = turned(logarithms)
        rollout = simulate([morphology], [controller], scene, [own])[0]
        if rollout.status >= 0:
            return _FAR, np.zeros(len(knobs))
        off = np.where(seen, rollout.positions - np.where(seen, observed, 0.0), 0.0)
        pull = 4 * off / seen.sum()
        (slope,) = gradients([morphology], [controller], scene, [own], [pull]).physics
        along = [np.sum(np.where(which, getattr(slope, n) * getattr(own, n), 0.0)) for n, which in parts]
        return 2 * float((off**2).sum()) / seen.sum(), np.array(along)

    unit = squares(np.zeros(len(knobs)))[0] or 1.0  # already there
    found = minimize(
        lambda z: tuple(v / unit for v in squares(z)),
        np.zeros(len(knobs)),
        jac=True,
        method="L-BFGS-B",
        bounds=[tuple(np.log(_FACTORS))] * len(knobs),
        options={"ftol": _SMALL, "gtol": 1e-10},
    )
    sides = [turned(found.x + sign * h) for h in _STEP * np.eye(len(knobs)) for sign in (1, -1)]
    moved = simulate([morphology] * len(sides), [controller] * len(sides), scene, sides)
    ends = np.array([r.positions[seen] for r in moved])
    errors = _standard_errors((ends[::2] - ends[1::2]) / (2 * _STEP), found.fun * unit / 2)
    return Fit(turned(found.x), np.exp(found.x), errors, float(np.sqrt(found.fun * unit)))


def _standard_errors(slopes: FloatArray, square: float) -> FloatArray:
    """Of parameters with these slopes of the values seen, (K, N), `square` being the mean square of what is
    left of these: noise of variance s2 in each makes their covariance s2 (J'J)^-1."""
    k, n = slopes.shape
    _, strength, directions = np.linalg.svd(slopes.T, full_matrices=False)
    told = strength > _NOTHING * strength.max()
    spread = ((directions[told].T / strength[told]) ** 2).sum(axis=1)
    spread[(np.abs(directions[~told]) > _NOTHING).any(axis=0)] = np.inf
    return np.sqrt(square * n / max(n - k, 1) * spread)


def _part(body: Morphology, knob: str) -> tuple[str, BoolArray]:
    """The field of `Physics` that a knob turns, and which of its values."""
    if knob.endswith(" stiffness"):
        return "stiffness", body.active if knob.startswith("active") else ~body.active
    return knob.replace(" ", "_"), np.array(True)


def _between(pull: FloatArray, parts: int) -> FloatArray:
    """The same where every step is divided."""
    finer = np.zeros(((len(pull) - 1) * parts + 1, *pull.shape[1:]))
    finer[::parts] = pull
    return finer


def _check_knobs(knobs: Sequence[str], scene: Scene) -> None:
    if not knobs or not set(knobs) <= set(KNOBS):
        raise InputError(
            "there is no such knob", expected=" | ".join(KNOBS), found=", ".join(knobs) or "none"
        )
    if "friction" in knobs and scene.contact not in GRIPPING:
        raise InputError(
            "a scene without friction has no such knob",
            expected="Scene.contact 'friction'",
            found=repr(scene.contact),
        )


def _check_pulls(bodies: Sequence[Morphology], scene: Scene, pulls: Sequence[FloatArray] | None) -> None:
    if scene.window is not None:
        raise InputError(
            "gradients with respect to physics are those of whole rollouts",
            expected="Scene.window None",
            found=str(scene.window),
        )
    if pulls is None:
        return
    wanted = [(scene.steps + 1, *body.positions.shape) for body in bodies]
    found = [np.shape(pull) for pull in pulls]
    if wanted != found:
        raise InputError("every robot needs pulls on its positions", expected=str(wanted), found=str(found))
