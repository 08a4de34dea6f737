"""Gradients of a motion with respect to controllers and physics.

One reverse sweep of the engine gives all gradients of the loss, or of any function of the motion. It costs
about one more simulation, however many springs and masses a robot has. `eldir.value_and_grad` takes a
function written with JAX; here its derivatives with respect to the motion are given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from eldir.controller import Controller
from eldir.core.arguments import require_count, require_shape, require_value
from eldir.core.records import FloatArray, IntArray, Record
from eldir.engine.stable_step import subdivide_steps
from eldir.engine.validity import NO_GRADIENT, OK, REFUSED
from eldir.errors import InputError
from eldir.morphology import Morphology
from eldir.physics import Physics, resolve_physics
from eldir.rollout import check_controllers, group_by_substeps, scene_step, select_from, split_by_memory
from eldir.scene import Scene

if TYPE_CHECKING:
    from eldir.engine.batch import BatchResult
    from eldir.engine.kept import KeptRollouts
    from eldir.engine.pack import MotionCotangents


@dataclass(frozen=True, eq=False)
class MotionGradient(Record):
    """The gradient of a function of the motion, for each of n robots."""

    losses: FloatArray
    """The values of the function, by default the loss [m], shape (n,); infinite for a robot that diverged or
    was refused, or whose gradient overflowed. Its gradients are zero."""
    controllers: tuple[Controller, ...]
    """The gradient with respect to each controller's weights."""
    physics: tuple[Physics, ...]
    """The gradient with respect to each robot's physics, per unit of each parameter."""
    status: IntArray
    """Status of each robot, shape (n,), as of `eldir.rollout.LossesAndGradients`."""


class Motion:
    """One robot's states while they are differentiated, in the precision of the scene."""

    def __init__(self, kept: KeptRollouts, r: int, parts: int):
        self._kept, self._r, self._parts = kept, r, parts

    def read(self, name: str) -> NDArray:
        """ "positions" [m] or "velocities" [m/s] of the masses, shape (T + 1, M, 2), or "activations" of the
        active springs, shape (T, A)."""
        values: NDArray = getattr(self._kept, name)(self._r)[:: self._parts]
        return values


MotionLoss = Callable[[int, Motion], tuple[float, "MotionCotangents"]]
"""A function of the robot with this index and of its motion: the value, and its derivatives."""


def motion_gradient(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
    cotangents: Sequence[FloatArray | MotionCotangents] | None = None,
) -> MotionGradient:
    """The gradient of the loss, or of your own function, with respect to controllers and physics.

    For your own function give `cotangents`: its derivatives with respect to the positions that `simulate`
    returns, shape (T + 1, M, 2) for each robot, or also with respect to velocities and activations
    (`eldir.engine.pack.MotionCotangents`). Raises `InputError` where a shape is wrong or the scene has a
    window.
    """
    from eldir.engine import batch
    from eldir.engine.pack import MotionCotangents

    owns = _check(morphologies, controllers, scene, physics)
    complete = None
    if cotangents is not None:
        require_count("cotangents", len(cotangents), len(morphologies))
        complete = [c if isinstance(c, MotionCotangents) else MotionCotangents(c) for c in cotangents]
        for i, given in enumerate(complete):
            _check_cotangents(f"robot {i}", morphologies[i], scene, given)
    found = _Gradients(controllers, owns)
    for parts, chosen in group_by_substeps(morphologies, scene, owns):
        finer = subdivide_steps(scene, parts)
        bodies, brains, own = select_from(chosen, morphologies, controllers, owns)
        for part in split_by_memory(bodies, finer.steps):
            here = chosen[part]
            spread = None
            if complete is not None:
                spread = [_spread_over_substeps(complete[i], parts) for i in here]
            outcome = batch.run_batch(
                bodies[part],
                brains[part],
                finer,
                own[part],
                config=batch.BatchConfig(backward=True, physics_gradients=True),
                cotangents=spread,
            )
            found.set(here, outcome, outcome.losses[:, 0], parts)
    return found.result()


def loss_gradient(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None,
    loss: MotionLoss,
) -> MotionGradient:
    """The values of your own function of the motion and its gradients, with one simulation of each robot.

    `loss` is called once for every robot that completes all steps. Raises `InputError` where a value or a
    derivative is not a finite number, or the scene has a window.
    """
    from eldir.engine.kept import KeptRollouts

    owns = _check(morphologies, controllers, scene, physics)
    found = _Gradients(controllers, owns)
    for parts, chosen in group_by_substeps(morphologies, scene, owns):
        finer = subdivide_steps(scene, parts)
        bodies, brains, own = select_from(chosen, morphologies, controllers, owns)
        for part in split_by_memory(bodies, finer.steps):
            kept = KeptRollouts(bodies[part], brains[part], finer, own[part])
            here, values = chosen[part], np.full(len(chosen[part]), np.inf)
            for robots in kept.parts():
                values[robots], cotangents = _evaluate(loss, kept, robots, here, bodies[part], finer, parts)
                kept.differentiate(robots, cotangents)
                for r, given in zip(robots, cotangents, strict=True):
                    if kept.status[r] == NO_GRADIENT:
                        _require_finite(here[r], given)
            outcome = kept.result()
            values[outcome.status != OK] = np.inf
            found.set(here, outcome, values, parts)
    return found.result()


def _evaluate(
    loss: MotionLoss,
    kept: KeptRollouts,
    robots: range,
    numbers: Sequence[int],
    bodies: Sequence[Morphology],
    finer: Scene,
    parts: int,
) -> tuple[list[float], list[MotionCotangents]]:
    """Values and cotangents of these robots, whose numbers the loss gets; a robot that diverged has none."""
    values, cotangents = [], []
    for r in robots:
        if kept.status[r] != OK:
            values.append(np.inf)
            cotangents.append(_no_cotangents(bodies[r], finer))
            continue
        value, pulled = loss(numbers[r], Motion(kept, r, parts))
        require_value(f"value of the loss of robot {numbers[r]}", np.isfinite(value), "finite", value)
        values.append(value)
        cotangents.append(_spread_over_substeps(pulled, parts))
    return values, cotangents


class _Gradients:
    """What a call returns, filled part by part."""

    def __init__(self, controllers: Sequence[Controller], physics: Sequence[Physics]):
        n = len(controllers)
        self._losses, self._status = np.full(n, np.inf), np.full(n, REFUSED, np.int32)
        self._controllers = [c.scaled(0.0) for c in controllers]
        self._physics = [own.scaled(0.0) for own in physics]

    def set(self, robots: Sequence[int], outcome: BatchResult, values: FloatArray, parts: int) -> None:
        """Take the gradients of these robots, whose steps were divided into so many parts."""
        self._losses[robots] = values
        self._status[robots] = [scene_step(step, parts) for step in outcome.status]
        weights = outcome.batch.controllers(outcome.best)
        for i, gradient, physical in zip(robots, weights, outcome.physics, strict=True):
            self._controllers[i], self._physics[i] = gradient, physical

    def result(self) -> MotionGradient:
        return MotionGradient(self._losses, tuple(self._controllers), tuple(self._physics), self._status)


def _check(
    bodies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None,
) -> list[Physics]:
    scene.require_controller()
    check_controllers(bodies, controllers)
    whole = "None: gradients with respect to physics are those of whole rollouts"
    require_value("Scene.window", scene.window is None, whole, scene.window)
    return resolve_physics(bodies, scene, physics)


def _check_cotangents(name: str, body: Morphology, scene: Scene, given: MotionCotangents) -> None:
    states = (scene.steps + 1, *body.positions.shape)
    wanted = {"positions": states, "velocities": states, "activations": (scene.steps, body.motors)}
    for key, shape in wanted.items():
        value = getattr(given, key)
        if value is not None:
            what = f"cotangents of {name}" if key == "positions" else f"cotangents of the {key} of {name}"
            require_shape(what, np.shape(value), shape)


def _require_finite(i: int, given: MotionCotangents) -> None:
    """Raise `InputError` where a gradient overflowed because the loss has no derivative there."""
    for name, value in given._asdict().items():
        wrong = [] if value is None else np.argwhere(~np.isfinite(value)).tolist()
        if wrong:
            raise InputError(
                f"the loss of robot {i} has no derivative with respect to its {name}",
                code="loss.no-derivative",
                expected="finite derivatives",
                found=f"{value[tuple(wrong[0])]:g} at index {wrong[0]}",
                remedy="roots and norms have none at zero: add a small number, as in sqrt(x * x + 1e-12)",
            )


def _spread_over_substeps(given: MotionCotangents, parts: int) -> MotionCotangents:
    """The same cotangents where every step is divided: zero between the scene's steps."""
    if parts == 1:
        return given
    states = len(given.positions)
    positions, *others = (None if v is None else _spread(v, states, parts) for v in given)
    return type(given)(cast(FloatArray, positions), *others)


def _spread(values: FloatArray, states: int, parts: int) -> FloatArray:
    finer = np.zeros(((len(values) - 1) * parts + 1, *values.shape[1:]), values.dtype)
    finer[::parts] = values
    if len(values) == states:
        return finer
    last = np.zeros((parts - 1, *values.shape[1:]), values.dtype)  # activations are one for each step
    return np.concatenate([finer, last])


def _no_cotangents(body: Morphology, scene: Scene) -> MotionCotangents:
    from eldir.engine.pack import MotionCotangents

    return MotionCotangents(np.zeros((scene.steps + 1, *body.positions.shape)))
