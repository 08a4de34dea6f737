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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_count, require_known, require_value
from eldir.engine.pack import MotionCotangents
from eldir.engine.validity import OK
from eldir.errors import InputError
from eldir.jax._pytrees import FIELDS, number_or_array
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.rollout import simulate as simulate_robots
from eldir.scene import Scene
from eldir.training.gradients import motion_gradient
from eldir.training.own_loss import RolloutArrays, import_jax, require_precision

jax = import_jax()

Arrays = Mapping[str, Any]
"""Arrays of NumPy or JAX by the name of a record's field."""


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
    scene.require_controller()
    require_value("Scene.window", scene.window is None, "None", scene.window)
    require_precision(scene)
    n = len(morphologies)
    require_count("controllers", len(controllers), n)
    require_count("physics", len(physics) if physics is not None else n, n)
    weights = [_arrays(Controller, c) for c in controllers]
    for given in weights:
        require_known("arrays of a controller", given, FIELDS[Controller])
        missing = [name for name in FIELDS[Controller] if name not in given]
        require_value("arrays of a controller", not missing, "w1, b1, w2, b2", ", ".join(given))
    own = [_arrays(Physics, p) for p in physics] if physics is not None else [{} for _ in morphologies]
    return _rollouts(_Robots(tuple(morphologies), scene), weights, own)  # type: ignore[no-any-return]


def simulate_one(
    morphology: Morphology,
    controller: Controller | Arrays,
    scene: Scene,
    physics: Physics | Arrays | None = None,
) -> RolloutArrays:
    """The rollout of one robot, as `simulate`."""
    own = None if physics is None else [physics]
    return simulate([morphology], [controller], scene, own)[0]


@dataclass(frozen=True, eq=False)
class _Robots:
    """What a rollout depends on and is not differentiated with respect to."""

    morphologies: tuple[Morphology, ...]
    scene: Scene

    def controllers(self, weights: Sequence[Arrays]) -> list[Controller]:
        return [Controller(**{k: np.asarray(v, np.float64) for k, v in given.items()}) for given in weights]

    def physics(self, own: Sequence[Arrays]) -> list[Physics]:
        pairs = zip(self.morphologies, own, strict=True)
        return [
            Physics.of(body, self.scene).replace(**{k: number_or_array(v) for k, v in given.items()})
            for body, given in pairs
        ]

    def simulate(self, weights: list[Any], own: list[Any]) -> list[RolloutArrays]:
        _require_numbers(weights, own)
        real = {"f32": np.float32, "f64": np.float64}[self.scene.precision]
        rollouts = simulate_robots(
            self.morphologies, self.controllers(weights), self.scene, self.physics(own)
        )
        return [
            RolloutArrays(*(_to_jax(v, real) for v in (r.positions, r.velocities, r.activations)))
            for r in rollouts
        ]


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _rollouts(robots: _Robots, weights: list[Any], own: list[Any]) -> list[RolloutArrays]:
    return robots.simulate(weights, own)


def _forward(robots: _Robots, weights: list[Any], own: list[Any]) -> tuple[list[RolloutArrays], Any]:
    values = jax.tree.map(lambda primal: primal.value, (weights, own), is_leaf=lambda p: hasattr(p, "value"))
    return robots.simulate(*values), values


def _backward(robots: _Robots, values: Any, pulled: list[RolloutArrays]) -> Any:
    _require_numbers(values, pulled)
    controllers, physics = robots.controllers(values[0]), robots.physics(values[1])
    cotangents = [_cotangents(robots, *one) for one in zip(robots.morphologies, pulled, strict=True)]
    found = motion_gradient(robots.morphologies, controllers, robots.scene, physics, cotangents)
    return tuple(
        [
            {name: _gradient_like(value, getattr(record, name), ok) for name, value in given.items()}
            for given, record, ok in zip(arrays, records, found.status == OK, strict=True)
        ]
        for arrays, records in zip(values, (found.controllers, found.physics), strict=True)
    )


def _cotangents(robots: _Robots, body: Morphology, pulled: RolloutArrays) -> MotionCotangents:
    """What JAX gives, without arrays for what a function does not depend on."""
    unused = jax.custom_derivatives.SymbolicZero
    positions, *others = (None if isinstance(p, unused) else np.asarray(p) for p in pulled)
    if positions is None:
        positions = np.zeros((robots.scene.steps + 1, *body.positions.shape))
    return MotionCotangents(positions, *others)


_rollouts.defvjp(_forward, _backward, symbolic_zeros=True)


def _arrays(kind: type[Any], given: Any) -> dict[str, Any]:
    """The fields of a record, or a dictionary as it is."""
    if isinstance(given, kind):
        return {name: getattr(given, name) for name in FIELDS[kind]}
    return dict(given)


def _gradient_like(value: Any, gradient: Any, ok: bool) -> Any:
    """A gradient of the same shape and type: one number stands for all springs or masses."""
    summed = np.sum(gradient) if np.ndim(value) == 0 else np.asarray(gradient)
    return _to_jax(summed if ok else np.full_like(summed, np.nan), jax.numpy.result_type(value))


def _to_jax(values: Any, kind: Any) -> Any:
    """As an array of JAX. NumPy converts: JAX would take three times as long."""
    return jax.numpy.asarray(np.asarray(values, kind))


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
