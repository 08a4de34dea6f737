"""Fitting a robot's physics to an observed motion, by gradients through the simulation.

Example: find the stiffness of a robot and the friction of its ground from 0.4 s of its motion.

    import numpy as np
    from eldir.genotype import random_genotypes
    from eldir.lattice import Lattice
    from eldir.morphology import develop
    from eldir.physics import Physics
    from eldir.rollout import simulate_one
    from eldir.scene import Scene
    from eldir.training.fitting import fit_physics
    from eldir.training.loop import initial_controllers

    scene = Scene.preset("paper").replace(contact="friction", steps=100, precision="f64")
    lattice = Lattice(6, 11)
    body = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(0))[0])
    (controller,) = initial_controllers([body], scene, seed=0)
    real = Physics.of(body, scene).replace(stiffness=2.4e4, friction=0.8)
    observed = simulate_one(body, controller, scene, real).positions
    found = fit_physics(body, controller, scene, observed, ["stiffness", "friction"])
    print(found.factors)  # 0.8 and 0.8: factors on the scene's stiffness and friction
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from eldir.controller import Controller
from eldir.core.arguments import require_known, require_shape, require_value
from eldir.core.records import BoolArray, FloatArray, Record
from eldir.engine.validity import OK
from eldir.morphology import Morphology
from eldir.physics import GRIPPING, Physics
from eldir.rollout import simulate, simulate_one
from eldir.scene import Scene
from eldir.training.gradients import motion_gradient

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
_DIVERGED = 1e6  # mean square distance of a robot that diverged [m2]
_MIN_IMPROVEMENT = 1e-14  # the fit ends at a smaller improvement, relative to the first sum of squares


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
    require_shape("observed", observed.shape, (scene.steps + 1, *morphology.positions.shape))
    require_value("observed", np.isfinite(observed).any(), "some finite positions")
    scene = scene.replace(large_step="subdivide")
    initial = start if start is not None else Physics.of(morphology, scene)
    scaled = tuple(_scaled_values(morphology, name) for name in parameters)
    problem = _FitProblem(morphology, controller, scene, observed, initial, scaled)
    zeros = np.zeros(len(parameters))
    unit = problem.mean_square(zeros)[0] or 1.0  # already there
    found = minimize(
        lambda z: tuple(v / unit for v in problem.mean_square(z)),
        zeros,
        jac=True,
        method="L-BFGS-B",
        bounds=[tuple(np.log(_FACTORS))] * len(parameters),
        options={"ftol": _MIN_IMPROVEMENT, "gtol": 1e-10},
    )
    errors = _standard_errors(problem.derivatives(found.x), found.fun * unit / 2)
    distance = float(np.sqrt(found.fun * unit))
    return PhysicsFit(problem.physics(found.x), np.exp(found.x), errors, distance)


@dataclass(frozen=True)
class _FitProblem:
    """Least squares: the logarithms of K factors for which a simulation is nearest to an observed motion."""

    morphology: Morphology
    controller: Controller
    scene: Scene
    observed: FloatArray
    """Positions [m], shape (T + 1, M, 2), NaN where a mass was not seen."""
    initial: Physics
    scaled: tuple[tuple[str, BoolArray], ...]
    """For each factor the field of `Physics` that it scales, and which of its values."""

    def physics(self, logarithms: FloatArray) -> Physics:
        """The initial physics times the factors."""
        own = self.initial
        for (name, which), factor in zip(self.scaled, np.exp(logarithms), strict=True):
            value = getattr(own, name)
            own = own.replace(
                **{name: value * np.where(which, factor, 1.0) if np.ndim(value) else value * factor}
            )
        return own

    def mean_square(self, logarithms: FloatArray) -> tuple[float, FloatArray]:
        """Mean square distance [m2] and its gradient with respect to the logarithms, shape (K,)."""
        own, seen = self.physics(logarithms), np.isfinite(self.observed)
        rollout = simulate_one(self.morphology, self.controller, self.scene, own)
        if rollout.status != OK:
            return _DIVERGED, np.zeros(len(self.scaled))
        off = np.where(seen, rollout.positions - np.where(seen, self.observed, 0.0), 0.0)
        cotangent = 4 * off / seen.sum()
        found = motion_gradient([self.morphology], [self.controller], self.scene, [own], [cotangent])
        if found.status[0] != OK:
            return _DIVERGED, np.zeros(len(self.scaled))
        (slope,) = found.physics
        gradient = [
            np.sum(np.where(which, getattr(slope, name) * getattr(own, name), 0.0))
            for name, which in self.scaled
        ]
        return 2 * float((off**2).sum()) / seen.sum(), np.array(gradient)

    def derivatives(self, logarithms: FloatArray) -> FloatArray:
        """Derivatives of the N observed values [m] with respect to the logarithms, shape (K, N)."""
        steps = _STEP * np.eye(len(self.scaled))
        sides = [self.physics(logarithms + sign * step) for step in steps for sign in (1, -1)]
        n = len(sides)
        moved = simulate([self.morphology] * n, [self.controller] * n, self.scene, sides)
        ends = np.array([rollout.positions[np.isfinite(self.observed)] for rollout in moved])
        return (ends[::2] - ends[1::2]) / (2 * _STEP)


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


def _scaled_values(body: Morphology, parameter: str) -> tuple[str, BoolArray]:
    """The field of `Physics` that a parameter scales, and which of its values."""
    if parameter.endswith(" stiffness"):
        return "stiffness", body.active if parameter.startswith("active") else ~body.active
    return parameter.replace(" ", "_"), np.array(True)


def _check_parameters(parameters: Sequence[str], scene: Scene) -> None:
    require_known("parameter to fit", parameters or "none", FIT_PARAMETERS)
    gripping = scene.contact in GRIPPING or "friction" not in parameters
    require_value("Scene.contact", gripping, "'friction', where friction is fitted", repr(scene.contact))
