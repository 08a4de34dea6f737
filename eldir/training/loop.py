"""The training loop: an update rule times a sampler of physics (paper, Sect. Learning).

In every iteration the sampler gives the physics of one or more robots with the same body, the engine gives
the loss and the gradient of each, and the rule moves the weights against the mean gradient. Without domain
randomisation and with updates of fixed length, the engine's kernel does all of this itself: `train` chooses
that fast path, and a test holds it to the loop. Each robot's random initial weights come from its own seed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_count, require_whole_number
from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.engine.threads import for_each
from eldir.engine.validity import OK, is_rounded
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.rollout import evaluate_gradients
from eldir.scene import Scene
from eldir.training.configuration import TrainingConfig

Key = tuple[int, ...]
"""Seed of the random initial weights of one robot."""


def initial_controllers(
    morphologies: Sequence[Morphology], scene: Scene, seed: int | Sequence[int]
) -> list[Controller]:
    """Random weights, each robot's from its own seed."""
    n = len(morphologies)
    keys = make_seed_keys(n, seed)
    require_count("seeds", len(keys), n)
    return list(InitialControllers(morphologies, scene, keys))


class InitialControllers(Sequence[Controller]):
    """The initial controller of each robot, made when it is read: thousands need not exist together."""

    def __init__(self, morphologies: Sequence[Morphology], scene: Scene, origins: Sequence[Controller | Key]):
        self._morphologies, self._scene, self._origins = morphologies, scene, origins

    def __len__(self) -> int:
        return len(self._morphologies)

    def __getitem__(self, r: Any) -> Any:
        return make_initial_controller(self._morphologies[r], self._scene, self._origins[r])

    def __iter__(self) -> Iterator[Controller]:
        return iter(for_each(self.__getitem__, len(self)))


def make_seed_keys(n: int, seed: int | Sequence[int]) -> list[Key]:
    """The key of each robot: (seed, index), or the robot's own seed. Raises `InputError` for no seed."""
    if isinstance(seed, Sequence | np.ndarray):
        return [(require_whole_number("seed of a robot", own, 0),) for own in seed]
    common = require_whole_number("seed", seed, 0)
    return [(common, i) for i in range(n)]


def make_initial_controller(body: Morphology, scene: Scene, origin: Controller | Key) -> Controller:
    """The given controller, or random weights from its key."""
    if isinstance(origin, Controller):
        return origin
    return Controller.random(
        len(body.positions),
        body.motors,
        np.random.default_rng(origin),
        released_springs=len(body.springs) if scene.weights == "released" else None,
    )


Sampler = Callable[[int, int], Sequence[Physics]]
"""The physics over which update `k` of robot `r` takes the mean: `sample(r, k)`, as many for every robot."""
Visit = Callable[[int, int, Controller], None]
"""A function that is called before each rollout, with the update, the robot and its weights."""


@dataclass(frozen=True)
class TrainingResult:
    """Result of the training of n robots."""

    losses: FloatArray
    """Losses before the first and after each update [m], shape (n, iterations + 1): the mean over the sampled
    physics, infinite from the update at which one of these robots diverged or its gradient overflowed."""
    controllers: list[Controller]
    """The controller with the least loss, of each robot."""
    status: IntArray
    """Status of each robot: -1, -3 if its gradient overflowed, or the step at which it diverged, shape
    (n,)."""
    growth: FloatArray
    """Growth of the gradient of each loss (`eldir.rollout.LossesAndGradients`), shape (n, iterations + 1):
    the greatest over the sampled physics, 0 where there was no gradient."""
    rounded: BoolArray
    """Whether rounding may dominate the gradient of each loss, shape (n, iterations + 1)."""


def train(
    bodies: Sequence[Morphology],
    initial: Sequence[Controller],
    physics: Sequence[Physics],
    scene: Scene,
    training: TrainingConfig,
    iterations: int,
    sample: Sampler | None = None,
) -> TrainingResult:
    """Train robots, by the engine's kernel where it can. Physics are those of `sample`, for every robot and
    update; without it they are the given ones."""
    if sample is not None:
        return descend(bodies, initial, scene, training, iterations, sample)
    if training.optimiser == "steps":
        return train_in_kernel(bodies, initial, physics, scene, training, iterations)
    return descend(bodies, initial, scene, training, iterations, lambda r, k: [physics[r]])


def train_in_kernel(
    bodies: Sequence[Morphology],
    initial: Sequence[Controller],
    physics: Sequence[Physics],
    scene: Scene,
    training: TrainingConfig,
    iterations: int,
) -> TrainingResult:
    """The same as `descend` with updates of fixed length and one physics for each robot, but all iterations
    in one call of the engine. Weights and norms are rounded to the scene's precision."""
    from eldir.engine import batch

    length = training.update_length
    outcome = batch.run_batch(
        bodies,
        initial,
        scene,
        physics,
        config=batch.BatchConfig(iterations=iterations, update_length=length, backward=True),
    )
    growth = outcome.growth
    return TrainingResult(
        outcome.losses,
        outcome.batch.controllers(outcome.best),
        outcome.status,
        growth,
        is_rounded(growth, scene),
    )


def descend(
    bodies: Sequence[Morphology],
    initial: Sequence[Controller],
    scene: Scene,
    training: TrainingConfig,
    iterations: int,
    sample: Sampler,
    visit: Visit = lambda update, robot, controller: None,
) -> TrainingResult:
    """Gradient descent, one call of the engine for each iteration. A robot that diverged, or whose gradient
    overflowed, learns no more."""
    n, initial = len(bodies), list(initial)
    kind = np.float32 if scene.precision == "f32" else np.float64  # what the engine computes in
    losses, status = np.full((n, iterations + 1), np.inf), np.full(n, OK, np.int32)
    growth, rounded = np.zeros(losses.shape), np.zeros(losses.shape, bool)
    weights, best = [c.flat for c in initial], list(initial)
    rules = [training.rule(len(w)) for w in weights]
    learning = list(range(n))
    for k in range(iterations + 1):
        brains = {r: initial[r].shaped(weights[r].astype(kind)) for r in learning}
        owns = {r: sample(r, k) for r in learning}
        for r in learning:
            visit(k, r, brains[r])
        found = evaluate_gradients(
            [bodies[r] for r in learning for _ in owns[r]],
            [brains[r] for r in learning for _ in owns[r]],
            scene,
            [own for r in learning for own in owns[r]],
        )
        values, gradients = found
        samples = len(values) // len(learning)
        losses[learning, k] = values.reshape(-1, samples).mean(axis=1)
        if k < iterations:  # no update follows the last loss
            growth[learning, k] = found.growth.reshape(-1, samples).max(axis=1)
            rounded[learning, k] = found.rounded.reshape(-1, samples).any(axis=1)
        for i, r in enumerate(learning):
            own = slice(i * samples, (i + 1) * samples)
            status[r] = _first_divergence(found.status[own])
            if losses[r, k] < losses[r, :k].min(initial=np.inf):
                best[r] = brains[r]
            gradient = np.mean([s.flat for s in gradients[own]], axis=0)
            weights[r] = weights[r] - rules[r].update(gradient)
        learning = [r for r in learning if status[r] == OK]
        if not learning:
            break
    return TrainingResult(losses, best, status, growth, rounded)


def _first_divergence(status: IntArray) -> int:
    """The status of several robots with one body: the first step at which one of them diverged, or else
    what is wrong with one of them."""
    diverged = status[status >= 0]
    return int(diverged.min() if len(diverged) else status.min())
