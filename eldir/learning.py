"""Training controllers by gradient descent (paper, Sect. Learning)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_count, require_whole_number
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.defaults import ITERATIONS
from eldir.engine.shortcuts import distinct
from eldir.engine.stable_step import subdivide_steps
from eldir.engine.validity import OK, REFUSED, is_chaotic
from eldir.errors import InputError
from eldir.morphology import Morphology
from eldir.physics import Physics, resolve_physics
from eldir.rollout import check_controllers, group_by_substeps, scene_step, select_from, simulate
from eldir.scene import Scene
from eldir.training import loop
from eldir.training.configuration import TrainingConfig
from eldir.training.loop import (
    InitialControllers,
    Key,
    Sampler,
    initial_controllers,
    make_initial_controller,
    make_seed_keys,
)
from eldir.training.randomisation import Randomisation

_ROBOTS_A_CALL = 256  # between two reports of progress; the result does not depend on it


@dataclass(frozen=True, eq=False)
class LearningResult(Record):
    """Result of learning, for n robots."""

    losses: FloatArray
    """Losses before the first and after each update [m], shape (n, iterations + 1); infinite from the update
    at which a robot diverged or its gradient overflowed. With domain randomisation, the mean over the
    sampled robots."""
    controllers: tuple[Controller, ...]
    """The controller with the least loss, of each robot."""
    status: IntArray
    """Status of each robot, shape (n,): -1 if it completed all steps, -2 if it was refused, -3 if its
    gradient overflowed (`eldir.engine.validity`), otherwise the step at which it diverged."""
    chaotic: BoolArray
    """For each loss, whether chaos dominates its gradient (`eldir.engine.validity.is_chaotic`), shape (n,
    iterations + 1). The last loss has no gradient. With domain randomisation: whether it does for one of
    the sampled robots, like the next."""
    rounded: BoolArray
    """For each loss, whether rounding may dominate its gradient (`eldir.engine.validity.is_rounded`)."""

    @property
    def displacements(self) -> FloatArray:
        """Mean forward displacements before the first and after each update [m], shape (n, iterations + 1):
        minus the losses."""
        return -self.losses

    @property
    def chaotic_updates(self) -> IntArray:
        """Updates of each robot whose gradient chaos dominates, shape (n,)."""
        return self.chaotic.sum(axis=1)

    @property
    def rounded_updates(self) -> IntArray:
        """Updates of each robot whose gradient rounding may dominate, shape (n,)."""
        return self.rounded.sum(axis=1)


def learn(
    morphologies: Sequence[Morphology],
    scene: Scene,
    iterations: int = ITERATIONS,
    seed: int | Sequence[int] = 0,
    controllers: Sequence[Controller] | None = None,
    progress: Callable[[int], None] | None = None,
    physics: Sequence[Physics] | None = None,
    training: TrainingConfig | None = None,
    randomisation: Randomisation | None = None,
) -> LearningResult:
    """Train the controller of every robot by gradient descent.

    - `seed`: one for all (robot i then has the seed (seed, i)), or one for each robot. With one for each, a
      robot's result does not depend on the other robots.
    - `controllers`: initial weights instead of random ones.
    - `progress`: a function that is called with the number of robots that are done.
    - `physics`: each robot's own parameters (`eldir.physics`), instead of the scene's.
    - `training`: optimiser and length of updates. Default: `TrainingConfig.of(scene)`.
    - `randomisation`: each update takes the mean gradient over robots whose physics are sampled from it.
      Steps that are too large for a sampled robot are divided.

    Raises `InputError` for wrong numbers and for arguments that do not fit each other, `EldirError` where the
    scene's step is too large for all robots.
    """
    scene.require_controller()
    iterations = require_whole_number("iterations", iterations, 1)
    if physics is not None and randomisation is not None:
        raise InputError(
            "physics given together with a randomisation",
            code="learning.two-physics",
            expected="either learn(physics=...) or learn(randomisation=...)",
            found="both",
        )
    learners = _Learners.of(morphologies, scene, seed, controllers, physics, randomisation)
    training = TrainingConfig.of(scene) if training is None else training
    if randomisation is not None:  # robots with one body and different seeds meet different physics
        return _learn(learners, scene, training, iterations, progress, randomisation)
    first, which = distinct(learners.morphologies, learners.origins, learners.physics)
    result = _learn(learners.take(first), scene, training, iterations, progress)
    if len(first) == len(which):
        return result
    trained = tuple(result.controllers[k] for k in which)  # the same robot learns the same
    return LearningResult(
        result.losses[which], trained, result.status[which], result.chaotic[which], result.rounded[which]
    )


@dataclass(frozen=True)
class _Learners:
    """n robots, and what the learning of each starts from."""

    morphologies: Sequence[Morphology]
    origins: Sequence[Controller | Key]
    """Initial controller of each robot, or the seed of its random weights."""
    physics: Sequence[Physics]
    seeds: Sequence[Key]
    """Seed of each robot's sampled physics."""

    @classmethod
    def of(
        cls,
        morphologies: Sequence[Morphology],
        scene: Scene,
        seed: int | Sequence[int],
        controllers: Sequence[Controller] | None,
        physics: Sequence[Physics] | None,
        randomisation: Randomisation | None,
    ) -> _Learners:
        """The robots of a call of `learn`. Raises `InputError` for arguments that do not fit each other."""
        n = len(morphologies)
        seeds = make_seed_keys(n, seed)
        origins = list(controllers) if controllers is not None else seeds
        require_count("controllers" if controllers is not None else "seeds", len(origins), n)
        if controllers is not None:
            check_controllers(morphologies, controllers)
        if randomisation is not None:
            require_count("seeds", len(seeds), n)
        return cls(morphologies, origins, resolve_physics(morphologies, scene, physics), seeds)

    def take(self, index: Sequence[int]) -> _Learners:
        """The robots with these indices; without seeds, of which there may be another number."""
        bodies, origins, physics = select_from(index, self.morphologies, self.origins, self.physics)
        return _Learners(bodies, origins, physics, ())

    def sampler(
        self, index: Sequence[int], scene: Scene, randomisation: Randomisation | None
    ) -> Sampler | None:
        """The sampler of the physics of the robots with these indices."""
        if randomisation is None:
            return None
        return lambda r, k: randomisation.sample_update(
            self.morphologies[index[r]], scene, self.seeds[index[r]], k
        )


def _learn(
    learners: _Learners,
    scene: Scene,
    training: TrainingConfig,
    iterations: int,
    progress: Callable[[int], None] | None,
    randomisation: Randomisation | None = None,
) -> LearningResult:
    """Train robots without duplicates. Initial weights exist only while they are needed: those of ten
    thousand robots would fill a gigabyte."""
    morphologies, origins, physics = learners.morphologies, learners.origins, learners.physics
    n = len(morphologies)
    losses, status = np.full((n, iterations + 1), np.inf), np.full(n, REFUSED, np.int32)
    growth, rounded = np.zeros(losses.shape), np.zeros(losses.shape, bool)
    best: dict[int, Controller] = {}
    at_once = max(1, _ROBOTS_A_CALL // (1 if randomisation is None else randomisation.samples))
    calls = [
        (parts, finer, chosen[first : first + at_once])
        for parts, finer, chosen in _by_step(morphologies, scene, physics, randomisation)
        for first in range(0, len(chosen), at_once)
    ]
    done = n - sum(len(part) for _, _, part in calls)
    for parts, finer, part in calls:
        bodies, owns = select_from(part, morphologies, physics)
        brains = InitialControllers(bodies, scene, *select_from(part, origins))
        sample = learners.sampler(part, finer, randomisation)
        trained = loop.train(bodies, brains, owns, finer, training, iterations, sample)
        losses[part], growth[part], rounded[part] = trained.losses, trained.growth, trained.rounded
        status[part] = [scene_step(t, parts) for t in trained.status]
        for i, controller in zip(part, trained.controllers, strict=True):
            if np.isfinite(losses[i, 0]):  # a robot that diverged at once has learned nothing
                best[i] = controller
        done += len(part)
        if progress is not None:
            progress(done)
    controllers = (
        best[i] if i in best else make_initial_controller(morphologies[i], scene, origins[i])
        for i in range(n)
    )
    return LearningResult(losses, tuple(controllers), status, is_chaotic(growth), rounded)


def _by_step(
    morphologies: Sequence[Morphology],
    scene: Scene,
    physics: Sequence[Physics],
    randomisation: Randomisation | None,
) -> Iterator[tuple[int, Scene, list[int]]]:
    """For each number of parts into which steps are divided: this number, the scene with these steps, and the
    robots. Refused robots are left out. Sampled physics need other steps in every update, so the loop divides
    them."""
    if randomisation is not None:
        yield 1, scene.replace(large_step="subdivide"), list(range(len(morphologies)))
        return
    for parts, chosen in group_by_substeps(morphologies, scene, physics):
        yield parts, subdivide_steps(scene, parts).replace(large_step="run"), chosen


def learning_paths(
    morphology: Morphology,
    scene: Scene,
    iterations: int,
    seed: int | Sequence[int],
    every: int = 1,
    training: TrainingConfig | None = None,
) -> FloatArray:
    """Centres of mass [m] of one robot in the rollout before the first and after each update, every few
    steps and at the end: shape (iterations + 1, P, 2), NaN from where it diverged. Raises `InputError` for a
    wrong number or seed.
    """
    iterations, every = (
        require_whole_number("iterations", iterations, 0),
        require_whole_number("every", every, 1),
    )
    scene.require_controller()
    training = TrainingConfig.of(scene) if training is None else training
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
    training: TrainingConfig,
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
        yield from (r.positions for r in rollouts if r.status == OK)
        return
    # The kernel keeps no trail: the robot is trained again for every iteration, so that each rollout is the
    # very one it learned from.
    for i in range(iterations + 1):
        outcome = batch.run_batch(
            [morphology], initial, scene,
            config=batch.BatchConfig(
                iterations=i, update_length=training.update_length, backward=i > 0, record=True
            ),
        )  # fmt: skip
        if outcome.status[0] != OK:
            return
        yield outcome.states(0)[0]
