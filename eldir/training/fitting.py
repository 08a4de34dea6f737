"""Gradients of a motion with respect to controllers and physics, and fitting a robot's physics to an observed
motion.

One reverse sweep of the engine gives all gradients of the loss, or of any function of the positions. It costs
about one more simulation, however many springs and masses a robot has.

Example: find the stiffness of a robot and the friction of its ground from 0.4 s of its motion.

    import numpy as np
    from eldir.genotype import random_genotypes
    from eldir.lattice import Lattice
    from eldir.morphology import develop
    from eldir.physics import Physics
    from eldir.rollout import simulate
    from eldir.scene import Scene
    from eldir.training.fitting import fit_physics
    from eldir.training.initial import initial_controllers

    scene = Scene.preset("paper").replace(contact="friction", steps=100, precision="f64")
    lattice = Lattice(6, 11)
    body = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(0))[0])
    (controller,) = initial_controllers([body], scene, seed=0)
    real = Physics.of(body, scene).replace(stiffness=2.4e4, friction=0.8)
    observed = simulate([body], [controller], scene, [real])[0].positions
    found = fit_physics(body, controller, scene, observed, ["stiffness", "friction"])
    print(found.factors)  # 0.8 and 0.8: factors on the scene's stiffness and friction
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from eldir.controller import Controller
from eldir.core.arguments import require_known, require_number, require_shape, require_value
from eldir.core.records import BoolArray, FloatArray, Record
from eldir.engine.stable_step import divided
from eldir.morphology import Morphology
from eldir.physics import GRIPPING, Physics, physics_of
from eldir.rollout import by_substeps, check, chosen_of, fitting_memory, simulate
from eldir.scene import Scene

FIT_PARAMETERS = (
    "stiffness",
    "passive stiffness",
    "active stiffness",
    "rest lengths",
    "damping",
    "gravity",
    "friction",
)
"""Names of the parameters that can be fitted: each is a factor on the initial value."""
_FACTORS = (0.1, 10.0)  # bounds of a factor
_STEP = 1e-4  # of a logarithm, for standard errors
_UNIDENTIFIABLE = 1e-6  # relative to the largest singular value
_FAR = 1e6  # mean square distance of a robot that blew up [m2]
_SMALL = 1e-14  # the fit ends at a smaller improvement, relative to the first sum of squares


@dataclass(frozen=True, eq=False)
class MotionGradient(Record):
    """The gradient of a function of the motion, for each of n robots."""

    losses: FloatArray
    """The losses [m], shape (n,); infinite for a robot that blew up or was refused, whose gradients are
    zero."""
    controllers: tuple[Controller, ...]
    """The gradient with respect to each controller's weights."""
    physics: tuple[Physics, ...]
    """The gradient with respect to each robot's physics, per unit of each parameter."""


@dataclass(frozen=True, eq=False)
class PhysicsFit(Record):
    """Physics fitted to an observed motion, by K parameters."""

    physics: Physics
    """The fitted physics."""
    factors: FloatArray
    """The factor of each parameter, shape (K,)."""
    errors: FloatArray
    """Relative standard errors of the factors, shape (K,), from the remaining noise and the slopes of the
    motion; infinite where the motion does not depend on a parameter."""
    distance: float
    """Root mean square distance from the observed positions [m]."""


def motion_gradient(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
    cotangents: Sequence[FloatArray] | None = None,
) -> MotionGradient:
    """The gradient of the loss, or of your own function, with respect to controllers and physics.

    For your own function give `cotangents`: its derivatives with respect to the positions that `simulate`
    returns, shape (T + 1, M, 2) for each robot. Raises `InputError` where a shape is wrong or the scene has a
    window.
    """
    from eldir.engine import batch

    scene.require_controller()
    check(morphologies, controllers)
    owns = physics_of(morphologies, scene, physics)
    _check_cotangents(morphologies, scene, cotangents)
    losses = np.full(len(morphologies), np.inf)
    slopes = [b.scaled(0.0) for b in controllers]
    physical = [own.scaled(0.0) for own in owns]
    for parts, chosen in by_substeps(morphologies, scene, owns):
        finer = divided(scene, parts)
        bodies, brains, own = chosen_of(chosen, morphologies, controllers, owns)
        for part in fitting_memory(bodies, finer.steps):
            here = chosen[part]
            pulled = None if cotangents is None else [_between(cotangents[i], parts) for i in here]
            outcome = batch.run_batch(
                bodies[part], brains[part], finer, own[part], backward=True, physical=True, cotangents=pulled
            )
            losses[here] = outcome.losses[:, 0]
            trained = outcome.batch.controllers(outcome.best)
            for i, weights, found in zip(here, trained, outcome.physics, strict=True):
                slopes[i], physical[i] = weights, found
    return MotionGradient(losses, tuple(slopes), tuple(physical))


def fit_physics(
    morphology: Morphology,
    controller: Controller,
    scene: Scene,
    observed: FloatArray,
    parameters: Sequence[str],
    start: Physics | None = None,
) -> PhysicsFit:
    """Fit some parameters (`FIT_PARAMETERS`), so that the mean square distance between the simulated and the
    observed motion is least.

    - `observed`: positions [m], shape (T + 1, M, 2), NaN where a mass was not seen.
    - `start`: the initial physics, by default the scene's.

    L-BFGS varies the logarithms of the factors and finds the nearest minimum. Long motions are chaotic and
    have many minima: fit short ones, in float64. Raises `InputError` for an unknown parameter or a wrong
    shape.
    """
    _check_parameters(parameters, scene)
    seen = np.isfinite(observed)
    shape = (scene.steps + 1, *morphology.positions.shape)
    require_shape("observed", observed.shape, shape)
    require_value("observed", seen.any(), "some finite positions")
    scene = scene.replace(large_step="subdivide")
    first = start if start is not None else Physics.of(morphology, scene)
    parts = [_part(morphology, name) for name in parameters]

    def scaled(logarithms: FloatArray) -> Physics:
        own = first
        for (name, which), factor in zip(parts, np.exp(logarithms), strict=True):
            value = getattr(own, name)
            own = own.replace(
                **{name: value * np.where(which, factor, 1.0) if np.ndim(value) else value * factor}
            )
        return own

    def squares(logarithms: FloatArray) -> tuple[float, FloatArray]:
        """Mean square distance [m2] and its gradient with respect to the logarithms of the factors."""
        own = scaled(logarithms)
        rollout = simulate([morphology], [controller], scene, [own])[0]
        if rollout.status >= 0:
            return _FAR, np.zeros(len(parameters))
        off = np.where(seen, rollout.positions - np.where(seen, observed, 0.0), 0.0)
        cotangent = 4 * off / seen.sum()
        (slope,) = motion_gradient([morphology], [controller], scene, [own], [cotangent]).physics
        along = [np.sum(np.where(which, getattr(slope, n) * getattr(own, n), 0.0)) for n, which in parts]
        return 2 * float((off**2).sum()) / seen.sum(), np.array(along)

    unit = squares(np.zeros(len(parameters)))[0] or 1.0  # already there
    found = minimize(
        lambda z: tuple(v / unit for v in squares(z)),
        np.zeros(len(parameters)),
        jac=True,
        method="L-BFGS-B",
        bounds=[tuple(np.log(_FACTORS))] * len(parameters),
        options={"ftol": _SMALL, "gtol": 1e-10},
    )
    sides = [scaled(found.x + sign * h) for h in _STEP * np.eye(len(parameters)) for sign in (1, -1)]
    moved = simulate([morphology] * len(sides), [controller] * len(sides), scene, sides)
    ends = np.array([r.positions[seen] for r in moved])
    errors = _standard_errors((ends[::2] - ends[1::2]) / (2 * _STEP), found.fun * unit / 2)
    return PhysicsFit(scaled(found.x), np.exp(found.x), errors, float(np.sqrt(found.fun * unit)))


def _standard_errors(slopes: FloatArray, square: float) -> FloatArray:
    """Standard errors of K parameters. `slopes`: derivatives of the N observed values, shape (K, N).
    `square`: the mean square of the residuals. Noise of variance s2 in each value makes the covariance of the
    parameters s2 (J'J)^-1."""
    k, n = slopes.shape
    _, strength, directions = np.linalg.svd(slopes.T, full_matrices=False)
    identified = strength > _UNIDENTIFIABLE * strength.max()
    spread = ((directions[identified].T / strength[identified]) ** 2).sum(axis=1)
    spread[(np.abs(directions[~identified]) > _UNIDENTIFIABLE).any(axis=0)] = np.inf
    return np.sqrt(square * n / max(n - k, 1) * spread)


def _part(body: Morphology, parameter: str) -> tuple[str, BoolArray]:
    """The field of `Physics` that a parameter scales, and which of its values."""
    if parameter.endswith(" stiffness"):
        return "stiffness", body.active if parameter.startswith("active") else ~body.active
    return parameter.replace(" ", "_"), np.array(True)


def _between(cotangent: FloatArray, parts: int) -> FloatArray:
    """The same cotangents where every step is divided: zero between the scene's steps."""
    finer = np.zeros(((len(cotangent) - 1) * parts + 1, *cotangent.shape[1:]))
    finer[::parts] = cotangent
    return finer


def _check_parameters(parameters: Sequence[str], scene: Scene) -> None:
    require_known("parameter to fit", parameters or "none", FIT_PARAMETERS)
    gripping = scene.contact in GRIPPING or "friction" not in parameters
    require_value("Scene.contact", gripping, "'friction', where friction is fitted", repr(scene.contact))


def _check_cotangents(
    bodies: Sequence[Morphology], scene: Scene, cotangents: Sequence[FloatArray] | None
) -> None:
    whole = "None: gradients with respect to physics are those of whole rollouts"
    require_value("Scene.window", scene.window is None, whole, scene.window)
    if cotangents is None:
        return
    require_number("cotangents", len(cotangents), len(bodies))
    for i, (body, cotangent) in enumerate(zip(bodies, cotangents, strict=True)):
        wanted = (scene.steps + 1, *body.positions.shape)
        require_shape(f"cotangents of robot {i}", np.shape(cotangent), wanted)
