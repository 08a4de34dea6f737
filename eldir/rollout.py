"""Simulation of robots, their losses, and the gradient of the loss with respect to their controllers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_count, require_value
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.engine.shortcuts import distinct
from eldir.engine.stable_step import subdivide_steps, substeps
from eldir.engine.validity import OK, REFUSED, is_chaotic, is_rounded
from eldir.morphology import Morphology
from eldir.physics import Physics, resolve_physics
from eldir.scene import Scene

_BATCH_VALUES = 2**28  # recorded by one call: 1 GB in float32


@dataclass(frozen=True, eq=False)
class Rollout(Record):
    """Motion of one robot over T steps."""

    positions: FloatArray
    """Positions of the masses [m], shape (T + 1, M, 2); the first row is after placement and lift."""
    velocities: FloatArray
    """Velocities of the masses [m/s], shape (T + 1, M, 2)."""
    activations: FloatArray
    """Activations of the active springs, from -1 to 1, in spring order, shape (T, A)."""
    loss: float
    """Minus the mean forward displacement [m]; infinite where the robot diverged."""
    status: int
    """`OK` (-1), the step at which the robot diverged, or `REFUSED` (-2) if the scene's step is too large
    for it (`eldir.engine.stable_step`). Later states are NaN. A robot diverges where a mass moves by a
    spring's length in one step (`eldir.engine.validity.max_speeds`)."""


class LossesAndGradients(tuple[FloatArray, list[Controller]]):
    """The losses and gradients of n robots, which it unpacks to, and how far they can be trusted."""

    status: IntArray
    """`OK` (-1), `REFUSED` (-2), `NO_GRADIENT` (-3), or the step at which the robot diverged, shape (n,).
    Without `OK` the loss is infinite and the gradient zero."""
    growth: FloatArray
    """How many times larger the gradient of a position became in the reverse sweep than at its beginning,
    shape (n,); 0 without motors."""
    chaotic: BoolArray
    """Whether chaos dominates the gradient (`eldir.engine.validity.is_chaotic`), shape (n,)."""
    rounded: BoolArray
    """Whether rounding may dominate the gradient (`eldir.engine.validity.is_rounded`), shape (n,)."""

    def __new__(
        cls,
        losses: FloatArray,
        gradients: list[Controller],
        status: IntArray,
        growth: FloatArray,
        rounded: BoolArray,
    ) -> LossesAndGradients:
        found = super().__new__(cls, (losses, gradients))
        found.status, found.growth, found.chaotic, found.rounded = status, growth, is_chaotic(growth), rounded
        return found

    def __getnewargs__(self) -> tuple[Any, ...]:  # for pickle and copy
        return *self, self.status, self.growth, self.rounded

    def take(self, index: Sequence[int]) -> LossesAndGradients:
        """Those of some robots."""
        losses, gradients = self
        return LossesAndGradients(
            losses[index],
            [gradients[i] for i in index],
            self.status[index],
            self.growth[index],
            self.rounded[index],
        )


def simulate(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
) -> list[Rollout]:
    """Simulate every robot for `scene.steps` steps. Rollouts are in input order. `physics` are each robot's
    own parameters (`eldir.physics`).

    Raises `EldirError` if the step is too large for all robots.
    """
    from eldir.engine import batch

    scene.require_controller()
    check_controllers(morphologies, controllers)
    owns = resolve_physics(morphologies, scene, physics)
    first, which = distinct(morphologies, controllers, owns)
    if len(first) < len(which):
        bodies, brains, own = select_from(first, morphologies, controllers, owns)
        rollouts = simulate(bodies, brains, scene, own)
        return [rollouts[k] for k in which]
    rollouts = [_refused_rollout(m, scene) for m in morphologies]
    for parts, chosen in group_by_substeps(morphologies, scene, owns):
        finer = subdivide_steps(scene, parts)
        bodies, brains, own = select_from(chosen, morphologies, controllers, owns)
        for part in split_by_memory(bodies, finer.steps):
            outcome = batch.run_batch(
                bodies[part], brains[part], finer, own[part], config=batch.BatchConfig(record=True)
            )
            for r, diverged in enumerate(outcome.status):
                x, v, a = outcome.states(r)
                if diverged != OK:
                    x[diverged + 1 :] = v[diverged + 1 :] = a[diverged + 1 :] = np.nan
                loss, status = float(outcome.losses[r, 0]), scene_step(diverged, parts)
                rollouts[chosen[part.start + r]] = Rollout(x[::parts], v[::parts], a[::parts], loss, status)
    return rollouts


def simulate_one(
    morphology: Morphology, controller: Controller, scene: Scene, physics: Physics | None = None
) -> Rollout:
    """The rollout of one robot, as `simulate`."""
    return simulate([morphology], [controller], scene, None if physics is None else [physics])[0]


def group_by_substeps(
    morphologies: Sequence[Morphology], scene: Scene, physics: Sequence[Physics]
) -> Iterator[tuple[int, list[int]]]:
    """Number of parts into which steps are divided, and the robots that it applies to; without refused
    ones."""
    counts = substeps(morphologies, scene, physics)
    for parts in np.unique(counts[counts > 0]):
        yield int(parts), np.flatnonzero(counts == parts).tolist()


def select_from(chosen: Sequence[int], *all_of: Sequence[Any]) -> list[list[Any]]:
    """The same elements of several sequences."""
    return [[one[i] for i in chosen] for one in all_of]


def scene_step(diverged: int, parts: int) -> int:
    """The status in the scene's steps, of a robot whose steps are divided."""
    return int(diverged) // parts if diverged >= 0 else int(diverged)


def _refused_rollout(body: Morphology, scene: Scene) -> Rollout:
    states = np.full((scene.steps + 1, len(body.positions), 2), np.nan)
    return Rollout(states, states, np.full((scene.steps, body.motors), np.nan), np.inf, REFUSED)


def losses(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
) -> FloatArray:
    """Loss of every robot, minus its mean forward displacement [m], shape (n,); infinite where it diverged or
    was refused. Nothing is recorded or differentiated: this is the fastest way to know how far robots walk.

    Raises `EldirError` if the step is too large for all robots.
    """
    from eldir.engine import batch

    scene.require_controller()
    check_controllers(morphologies, controllers)
    owns = resolve_physics(morphologies, scene, physics)
    first, which = distinct(morphologies, controllers, owns)
    bodies, brains, own = select_from(first, morphologies, controllers, owns)
    found = np.full(len(first), np.inf)
    for parts, chosen in group_by_substeps(bodies, scene, own):
        part = select_from(chosen, bodies, brains, own)
        found[chosen] = batch.run_batch(part[0], part[1], subdivide_steps(scene, parts), part[2]).losses[:, 0]
    return found[which]


def loss_and_gradient(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
) -> LossesAndGradients:
    """Losses, shape (n,), and for every robot the gradient of its loss, shaped as its controller.

    A robot that diverged or was refused, or whose gradient overflowed, has an infinite loss and a gradient
    of zero. The result unpacks to losses and gradients; its `status`, `chaotic` and `rounded` say how far
    they can be trusted. Raises `EldirError` if the step is too large for all robots.
    """
    scene.require_controller()
    check_controllers(morphologies, controllers)
    owns = resolve_physics(morphologies, scene, physics)
    first, which = distinct(morphologies, controllers, owns)
    if len(first) < len(which):
        bodies, brains, own = select_from(first, morphologies, controllers, owns)
        return evaluate_gradients(bodies, brains, scene, own).take(which)
    return evaluate_gradients(morphologies, controllers, scene, owns)


def evaluate_gradients(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics],
) -> LossesAndGradients:
    """`loss_and_gradient` without checks, and without a search for equal robots."""
    from eldir.engine import batch

    n = len(morphologies)
    losses, status = np.full(n, np.inf), np.full(n, REFUSED, np.int32)
    growth, rounded, gradients = np.zeros(n), np.zeros(n, bool), [b.scaled(0.0) for b in controllers]
    for parts, chosen in group_by_substeps(morphologies, scene, physics):
        finer = subdivide_steps(scene, parts)
        bodies, brains, own = select_from(chosen, morphologies, controllers, physics)
        outcome = batch.run_batch(bodies, brains, finer, own, config=batch.BatchConfig(backward=True))
        losses[chosen], growth[chosen] = outcome.losses[:, 0], outcome.growth[:, 0]
        status[chosen] = [scene_step(step, parts) for step in outcome.status]
        rounded[chosen] = is_rounded(growth[chosen], finer)
        for i, gradient in zip(chosen, outcome.batch.controllers(outcome.best), strict=True):
            gradients[i] = gradient
    return LossesAndGradients(losses, gradients, status, growth, rounded)


def split_by_memory(morphologies: Sequence[Morphology], steps: int) -> Iterator[slice]:
    """Consecutive robots whose states fit into memory."""
    first, values = 0, 0
    for i, body in enumerate(morphologies):
        size = (4 * len(body.positions) + body.motors + 96) * (steps + 1)
        if values and values + size > _BATCH_VALUES:
            yield slice(first, i)
            first, values = i, 0
        values += size
    if first < len(morphologies):
        yield slice(first, len(morphologies))


def check_controllers(morphologies: Sequence[Morphology], controllers: Sequence[Controller]) -> None:
    """Raise `InputError` unless there is one controller of the right shape, with finite weights, for each
    robot."""
    require_count("controllers", len(controllers), len(morphologies))
    for i, (body, brain) in enumerate(zip(morphologies, controllers, strict=True)):
        brain.require_fit(f"controller {i}", len(body.positions), body.motors)
        finite = all(np.isfinite(w).all() for w in (brain.w1, brain.b1, brain.w2, brain.b2))
        require_value(f"controller {i}", finite, "finite weights")
