"""The training loop: an update rule times a sampler of physics (paper, Sect. Learning).

In every iteration the sampler gives the physics of one or more robots with the same body, the engine gives
the loss and the gradient of each, and the rule moves the weights against the mean gradient. Without domain
randomisation and with updates of fixed length, the engine's kernel does all of this itself: `train` chooses
that fast path, and a test holds it to the loop.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eldir.controller import Controller
from eldir.core.records import FloatArray, IntArray
from eldir.engine.stable_step import divided
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.rollout import FINE, REFUSED, by_substeps, chosen_of, in_steps
from eldir.scene import Scene
from eldir.training.configuration import Training
from eldir.training.initial import Key
from eldir.training.randomisation import Randomisation

Sampler = Callable[[int, int], Sequence[Physics]]
"""The physics over which update `k` of robot `r` takes the mean: `sample(r, k)`, as many for every robot."""
Visit = Callable[[int, int, Controller], None]
"""A function that is called before each rollout, with the update, the robot and its weights."""


@dataclass(frozen=True)
class TrainingResult:
    """Result of the training of n robots."""

    losses: FloatArray
    """Losses before the first and after each update [m], shape (n, iterations + 1): the mean over the sampled
    physics, infinite from the update at which one of these robots blew up."""
    controllers: list[Controller]
    """The controller with the least loss, of each robot."""
    status: IntArray
    """Status of each robot: -1, or the step at which it blew up, shape (n,)."""


def train(
    bodies: Sequence[Morphology],
    initial: Sequence[Controller],
    physics: Sequence[Physics],
    scene: Scene,
    training: Training,
    iterations: int,
    randomisation: Randomisation | None = None,
    keys: Sequence[Key] = (),
) -> TrainingResult:
    """Teach robots, by the engine's kernel where it can. With `randomisation`, physics are drawn from it for
    every robot and update, from the robot's key; otherwise they are the given ones."""
    if training.optimiser == "steps" and randomisation is None:
        return in_kernel(bodies, initial, physics, scene, training, iterations)
    if randomisation is None:
        return descend(bodies, initial, scene, training, iterations, lambda r, k: [physics[r]])
    drawn = randomisation
    return descend(
        bodies,
        initial,
        scene,
        training,
        iterations,
        lambda r, k: drawn.draws_of(bodies[r], scene, keys[r], k),
    )


def in_kernel(
    bodies: Sequence[Morphology],
    initial: Sequence[Controller],
    physics: Sequence[Physics],
    scene: Scene,
    training: Training,
    iterations: int,
) -> TrainingResult:
    """The same as `descend` with updates of fixed length and one physics for each robot, but all iterations
    in one call of the engine. Weights and norms are rounded to the scene's precision."""
    from eldir.engine import batch

    length = training.update_length
    outcome = batch.run_batch(
        bodies, initial, scene, physics, iterations=iterations, update_length=length, backward=True
    )
    return TrainingResult(outcome.losses, outcome.batch.controllers(outcome.best), outcome.status)


def descend(
    bodies: Sequence[Morphology],
    initial: Sequence[Controller],
    scene: Scene,
    training: Training,
    iterations: int,
    sample: Sampler,
    visit: Visit = lambda update, robot, controller: None,
) -> TrainingResult:
    """Gradient descent, one call of the engine for each iteration. A robot that blew up learns no more."""
    n, initial = len(bodies), list(initial)
    kind = np.float32 if scene.precision == "f32" else np.float64  # what the engine computes in
    losses, status = np.full((n, iterations + 1), np.inf), np.full(n, FINE, np.int32)
    weights, best = [c.flat for c in initial], list(initial)
    rules = [training.rule(len(w)) for w in weights]
    learning = list(range(n))
    for k in range(iterations + 1):
        brains = {r: initial[r].shaped(weights[r].astype(kind)) for r in learning}
        owns = {r: sample(r, k) for r in learning}
        for r in learning:
            visit(k, r, brains[r])
        found, slopes, stopped = _evaluate(
            [bodies[r] for r in learning for _ in owns[r]],
            [brains[r] for r in learning for _ in owns[r]],
            scene,
            [own for r in learning for own in owns[r]],
        )
        draws = len(found) // len(learning)
        losses[learning, k] = found.reshape(-1, draws).mean(axis=1)
        for i, r in enumerate(learning):
            drawn = slice(i * draws, (i + 1) * draws)
            status[r] = _first(stopped[drawn])
            if losses[r, k] < losses[r, :k].min(initial=np.inf):
                best[r] = brains[r]
            gradient = np.mean([s.flat for s in slopes[drawn]], axis=0)
            weights[r] = weights[r] - rules[r].update(gradient)
        learning = [r for r in learning if status[r] == FINE]
        if not learning:
            break
    return TrainingResult(losses, best, status)


def _evaluate(
    bodies: Sequence[Morphology], brains: Sequence[Controller], scene: Scene, physics: Sequence[Physics]
) -> tuple[FloatArray, list[Controller], IntArray]:
    """Losses, gradients and status, as `eldir.rollout.loss_and_gradient`, which gives no status."""
    from eldir.engine import batch

    losses, status = np.full(len(bodies), np.inf), np.full(len(bodies), REFUSED, np.int32)
    gradients = [b.scaled(0.0) for b in brains]
    for parts, chosen in by_substeps(bodies, scene, physics):
        some, controllers, owns = chosen_of(chosen, bodies, brains, physics)
        outcome = batch.run_batch(some, controllers, divided(scene, parts), owns, backward=True)
        losses[chosen] = outcome.losses[:, 0]
        status[chosen] = [in_steps(step, parts) for step in outcome.status]
        for i, gradient in zip(chosen, outcome.batch.controllers(outcome.best), strict=True):
            gradients[i] = gradient
    return losses, gradients, status


def _first(status: IntArray) -> int:
    """The status of several robots with one body: the first step at which one of them blew up."""
    stopped = status[status != FINE]
    return int(stopped.min()) if len(stopped) else FINE
