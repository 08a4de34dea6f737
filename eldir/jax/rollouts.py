"""Rollouts as functions that JAX differentiates, for losses of several rollouts or of your own parameters.

    import eldir.jax
    import jax

    def loss(controller):
        up, down = (eldir.jax.simulate_one(body, controller, scene).positions for scene in (rising, falling))
        return abs(up[-1, :, 0].mean() - down[-1, :, 0].mean())

    gradient = jax.grad(loss)(controller)  # a Controller

`Controller` and `Physics` are pytrees: `jax.grad`, `jax.tree.map` and optimisers take and return them. JAX
calls the engine with numbers, so these functions work within `jax.grad`, `jax.value_and_grad` and `jax.vjp`,
not within `jax.jit` or `jax.vmap`; compile what comes before and after them. Needs JAX:
pip install 'eldir[jax]'.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from eldir.controller import Controller
from eldir.errors import InputError
from eldir.jax import _pytrees  # noqa: F401  registers controllers and physics
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene
from eldir.training.differentiable import Arrays, DifferentiableRollouts, RolloutArrays
from eldir.training.own_loss import import_jax, require_precision

jax = import_jax()


def simulate(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller | Arrays],
    scene: Scene,
    physics: Sequence[Physics | Arrays] | None = None,
) -> list[RolloutArrays]:
    """The rollouts of all robots, simulated together as by `eldir.simulate`, and differentiable with respect
    to controllers and physics.

    A controller may be a dictionary of its arrays "w1", "b1", "w2" and "b2", so that they can be functions of
    your own parameters. Physics may be a dictionary of some of its fields; the others are the scene's and the
    body's. States of a robot that diverged are NaN, and so are its gradients, those that overflowed, and
    those of a function that has no derivative there.

    Differentiating costs a second simulation and the reverse sweep; `eldir.value_and_grad` needs no second
    one. Raises `InputError` where an argument is invalid or JAX is compiling, `EldirError` where the step is
    too large for all robots.
    """
    require_precision(scene)
    robots = DifferentiableRollouts(tuple(morphologies), scene)
    return _rollouts(robots, *robots.arrays(controllers, physics))  # type: ignore[no-any-return]


def simulate_one(
    morphology: Morphology,
    controller: Controller | Arrays,
    scene: Scene,
    physics: Physics | Arrays | None = None,
) -> RolloutArrays:
    """The rollout of one robot, as `simulate`."""
    own = None if physics is None else [physics]
    return simulate([morphology], [controller], scene, own)[0]


def _run(robots: DifferentiableRollouts, weights: list[Any], own: list[Any]) -> list[RolloutArrays]:
    _require_numbers(weights, own)
    # Converted by NumPy before: JAX would take three times as long.
    return [RolloutArrays(*map(jax.numpy.asarray, found)) for found in robots.run(weights, own)]


def _forward(robots: DifferentiableRollouts, weights: list[Any], own: list[Any]) -> tuple[Any, Any]:
    values = jax.tree.map(lambda primal: primal.value, (weights, own), is_leaf=lambda p: hasattr(p, "value"))
    return _run(robots, *values), values


def _backward(robots: DifferentiableRollouts, values: Any, pulled: list[RolloutArrays]) -> Any:
    _require_numbers(values, pulled)
    unused = jax.custom_derivatives.SymbolicZero
    derivatives = [RolloutArrays(*(None if isinstance(d, unused) else d for d in one)) for one in pulled]
    return robots.pull_back(values[0], values[1], derivatives, _as_jax)


_rollouts = jax.custom_vjp(_run, nondiff_argnums=(0,))
_rollouts.defvjp(_forward, _backward, symbolic_zeros=True)


def _as_jax(gradient: Any, value: Any) -> Any:
    """As an array of the type of the array that it belongs to."""
    return jax.numpy.asarray(np.asarray(gradient, jax.numpy.result_type(value)))


def _require_numbers(*trees: Any) -> None:
    """Raise `InputError` where JAX compiles, vectorises or differentiates twice, and there are no numbers."""
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))
    if traced:
        raise InputError(
            "eldir.jax.simulate cannot be compiled, vectorised or differentiated twice",
            code="loss.traced",
            expected="numbers: jax.grad, jax.value_and_grad and jax.vjp give them",
            found="the tracers of jax.jit, jax.vmap or jax.hessian",
            remedy="compile what comes before and after it, and give several robots in one call",
        )
