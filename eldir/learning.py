"""Teaching controllers by gradient descent (paper, Sect. Learning)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_number, whole_number
from eldir.core.records import FloatArray, IntArray, Record
from eldir.engine.deduplicate import distinct
from eldir.engine.stable_step import divided
from eldir.errors import InputError
from eldir.morphology import Morphology
from eldir.physics import Physics, physics_of
from eldir.rollout import FINE, REFUSED, by_substeps, check, chosen_of, in_steps, simulate
from eldir.scene import Scene
from eldir.training import loop
from eldir.training.configuration import Training
from eldir.training.defaults import ITERATIONS
from eldir.training.initial import InitialControllers, Key, initial_controllers, initial_of, keys_of
from eldir.training.randomisation import Randomisation

_ROBOTS_A_CALL = 256  # between two reports of progress; the result does not depend on it


@dataclass(frozen=True, eq=False)
class LearningResult(Record):
    """Result of learning, for n robots."""

    losses: FloatArray
    """Losses before the first and after each update [m], shape (n, iterations + 1); infinite from the update
    at which a robot blew up. With domain randomisation, the mean over the drawn robots."""
    controllers: tuple[Controller, ...]
    """The controller with the least loss, of each robot."""
    status: IntArray
    """Status of each robot, shape (n,): -1 if it completed all steps, -2 if it was refused
    (`eldir.rollout.REFUSED`), otherwise the step at which it blew up."""


def learn(
    morphologies: Sequence[Morphology],
    scene: Scene,
    iterations: int = ITERATIONS,
    seed: int | Sequence[int] = 0,
    controllers: Sequence[Controller] | None = None,
    progress: Callable[[int], None] | None = None,
    physics: Sequence[Physics] | None = None,
    training: Training | None = None,
    randomisation: Randomisation | None = None,
) -> LearningResult:
    """Teach the controller of every robot by gradient descent.

    - `seed`: one for all (robot i then draws from (seed, i)), or one for each robot. With one for each, a
      robot's result does not depend on the other robots.
    - `controllers`: initial weights instead of random ones.
    - `progress`: a function that is called with the number of robots that are done.
    - `physics`: each robot's own parameters (`eldir.physics`), instead of the scene's.
    - `training`: optimiser and length of updates. Default: `Training.of(scene)`.
    - `randomisation`: each update takes the mean gradient over robots whose physics are drawn from it. Steps
      that are too large for a drawn robot are divided.

    Raises `InputError` for wrong numbers and for arguments that do not fit each other, `EldirError` where the
    scene's step is too large for all robots.
    """
    scene.require_controller()
    iterations = whole_number("iterations", iterations, 1)
    if physics is not None and randomisation is not None:
        raise InputError(
            "physics are given and drawn",
            code="learning.two-physics",
            expected="either learn(physics=...) or learn(randomisation=...)",
            found="both",
        )
    n = len(morphologies)
    keys = keys_of(n, seed)
    origins = list(controllers) if controllers is not None else keys
    require_number("controllers" if controllers is not None else "seeds", len(origins), n)
    if controllers is not None:
        check(morphologies, controllers)
    if randomisation is not None:
        require_number("seeds", len(keys), n)
    owns = physics_of(morphologies, scene, physics)
    training = Training.of(scene) if training is None else training
    if randomisation is not None:  # robots with one body and different seeds meet different physics
        return _learn(morphologies, origins, owns, scene, training, iterations, progress, randomisation, keys)
    first, which = distinct(morphologies, origins, owns)
    bodies, origins, owns = chosen_of(first, morphologies, origins, owns)
    result = _learn(bodies, origins, owns, scene, training, iterations, progress)
    if len(first) == n:
        return result
    trained = tuple(result.controllers[k] for k in which)  # the same robot learns the same
    return LearningResult(result.losses[which], trained, result.status[which])


def _learn(
    morphologies: Sequence[Morphology],
    origins: Sequence[Controller | Key],
    physics: Sequence[Physics],
    scene: Scene,
    training: Training,
    iterations: int,
    progress: Callable[[int], None] | None,
    randomisation: Randomisation | None = None,
    keys: Sequence[Key] = (),
) -> LearningResult:
    """Teach robots without duplicates. Initial weights exist only while they are needed: those of ten
    thousand robots would fill a gigabyte."""
    n = len(morphologies)
    losses, status = np.full((n, iterations + 1), np.inf), np.full(n, REFUSED, np.int32)
    best: dict[int, Controller] = {}
    at_once = max(1, _ROBOTS_A_CALL // (1 if randomisation is None else randomisation.draws))
    calls = [
        (parts, finer, chosen[first : first + at_once])
        for parts, finer, chosen in _by_step(morphologies, scene, physics, randomisation)
        for first in range(0, len(chosen), at_once)
    ]
    done = n - sum(len(part) for _, _, part in calls)
    for parts, finer, part in calls:
        bodies, owns = chosen_of(part, morphologies, physics)
        brains = InitialControllers(bodies, scene, *chosen_of(part, origins))
        drawn = [keys[i] for i in part] if keys else []
        trained = loop.train(bodies, brains, owns, finer, training, iterations, randomisation, drawn)
        losses[part] = trained.losses
        status[part] = [in_steps(t, parts) for t in trained.status]
        for i, controller in zip(part, trained.controllers, strict=True):
            if np.isfinite(losses[i, 0]):  # a robot that blew up at once has learned nothing
                best[i] = controller
        done += len(part)
        if progress is not None:
            progress(done)
    controllers = (best[i] if i in best else initial_of(morphologies[i], scene, origins[i]) for i in range(n))
    return LearningResult(losses, tuple(controllers), status)


def _by_step(
    morphologies: Sequence[Morphology],
    scene: Scene,
    physics: Sequence[Physics],
    randomisation: Randomisation | None,
) -> Iterator[tuple[int, Scene, list[int]]]:
    """For each number of parts into which steps are divided: this number, the scene with these steps, and the
    robots. Refused robots are left out. Drawn physics need other steps in every update, so the loop divides
    them."""
    if randomisation is not None:
        yield 1, scene.replace(large_step="subdivide"), list(range(len(morphologies)))
        return
    for parts, chosen in by_substeps(morphologies, scene, physics):
        yield parts, divided(scene, parts).replace(large_step="run"), chosen


def learning_paths(
    morphology: Morphology,
    scene: Scene,
    iterations: int,
    seed: int | Sequence[int],
    every: int = 1,
    training: Training | None = None,
) -> FloatArray:
    """Centres of mass [m] of one robot in the rollout before the first and after each update, every few
    steps and at the end: shape (iterations + 1, P, 2), NaN from where it blew up. Raises `InputError` for a
    wrong number or seed.
    """
    iterations, every = whole_number("iterations", iterations, 0), whole_number("every", every, 1)
    scene.require_controller()
    training = Training.of(scene) if training is None else training
    initial = initial_controllers([morphology], scene, seed)
    states = np.union1d(np.arange(0, scene.steps, every), scene.steps)
    paths = np.full((iterations + 1, len(states), 2), np.nan)
    for i, positions in enumerate(_rollouts(morphology, initial, scene, training, iterations)):
        paths[i] = positions.mean(axis=1)[states]
    return paths


def _rollouts(
    morphology: Morphology,
    initial: Sequence[Controller],
    scene: Scene,
    training: Training,
    iterations: int,
) -> Iterator[FloatArray]:
    """Positions [m], shape (T + 1, M, 2), before the first and after each update, until the robot blows
    up."""
    from eldir.engine import batch

    if training.optimiser != "steps":
        trail: list[Controller] = []
        own = Physics.of(morphology, scene)
        loop.descend(
            [morphology], initial, scene, training, iterations,
            lambda r, k: [own], lambda k, r, controller: trail.append(controller),
        )  # fmt: skip
        rollouts = simulate([morphology] * len(trail), trail, scene)
        yield from (r.positions for r in rollouts if r.status == FINE)
        return
    # The kernel keeps no trail: the robot is taught again for every iteration, so that each rollout is the
    # very one it learned from.
    for i in range(iterations + 1):
        outcome = batch.run_batch(
            [morphology], initial, scene,
            iterations=i, update_length=training.update_length, backward=i > 0, record=True,
        )  # fmt: skip
        if outcome.status[0] >= 0:
            return
        yield outcome.states(0)[0]
