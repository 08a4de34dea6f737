"""Teaching controllers by gradient descent (paper, Sect. Learning)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eldir.controller import Controller
from eldir.core.records import FloatArray, IntArray, Record
from eldir.engine.deduplicate import distinct
from eldir.engine.stable_step import divided
from eldir.errors import InputError
from eldir.morphology import Morphology
from eldir.physics import Physics, physics_of
from eldir.rollout import REFUSED, by_substeps, chosen_of, in_steps
from eldir.scene import Scene
from eldir.training import adam
from eldir.training.initial import Key, initial_controllers, initial_of, keys_of

_ROBOTS_A_CALL = 256  # between two reports of progress; the result does not depend on it


@dataclass(frozen=True, eq=False)
class LearningResult(Record):
    """What n robots learned."""

    losses: FloatArray
    """Before the first and after each update [m], shape (n, iterations + 1); infinite from where a
    robot blew up."""
    controllers: tuple[Controller, ...]
    """The weights with the least loss of each robot."""
    status: IntArray
    """-1, the step at which a robot blew up, or -2: refused (`eldir.rollout.REFUSED`), shape (n,)."""


def learn(
    morphologies: Sequence[Morphology],
    scene: Scene,
    iterations: int = 35,
    seed: int | Sequence[int] = 0,
    controllers: Sequence[Controller] | None = None,
    progress: Callable[[int], None] | None = None,
    physics: Sequence[Physics] | None = None,
) -> LearningResult:
    """Teach every robot for some iterations, by the scene's optimiser.

    `seed`: one for all (robot i then draws from (seed, i)), or one for each robot, so that its result
    does not depend on its company. `controllers` replace the random initial weights. `progress` is
    told how many robots are done. `physics` are parameters of each robot's own (`eldir.physics`). Raises
    `EldirError` where the scene's step is too large for all of them.
    """
    scene.require_controller()
    if iterations < 1:
        raise InputError("too few iterations", expected="at least 1", found=str(iterations))
    n = len(morphologies)
    origins = list(controllers) if controllers is not None else keys_of(n, seed)
    if len(origins) != n:
        raise InputError(
            f"every robot needs one {'seed' if controllers is None else 'controller'}",
            expected=str(n),
            found=str(len(origins)),
        )
    owns = physics_of(morphologies, scene, physics)
    first, which = distinct(morphologies, origins, owns)
    bodies, origins, owns = chosen_of(first, morphologies, origins, owns)
    result = _learn(bodies, origins, owns, scene, iterations, progress)
    if len(first) == n:
        return result
    taught = tuple(result.controllers[k] for k in which)  # the same robot learns the same
    return LearningResult(result.losses[which], taught, result.status[which])


def _learn(
    morphologies: Sequence[Morphology],
    origins: Sequence[Controller | Key],
    physics: Sequence[Physics],
    scene: Scene,
    iterations: int,
    progress: Callable[[int], None] | None,
) -> LearningResult:
    """For robots that differ. Initial weights exist only while they are needed: those of ten thousand robots
    would fill a gigabyte."""

    n = len(morphologies)
    losses, status = np.full((n, iterations + 1), np.inf), np.full(n, REFUSED, np.int32)
    best: dict[int, Controller] = {}
    calls = [
        (parts, chosen[first : first + _ROBOTS_A_CALL])
        for parts, chosen in by_substeps(morphologies, scene, physics)
        for first in range(0, len(chosen), _ROBOTS_A_CALL)
    ]
    done = n - sum(len(part) for _, part in calls)
    for parts, part in calls:
        bodies, owns = chosen_of(part, morphologies, physics)
        brains = [initial_of(morphologies[i], scene, origins[i]) for i in part]
        finer = divided(scene, parts)
        losses[part], taught_here, stopped = _TEACH[scene.optimiser](bodies, brains, owns, finer, iterations)
        status[part] = [in_steps(t, parts) for t in stopped]
        for i, taught in zip(part, taught_here, strict=True):
            if np.isfinite(losses[i, 0]):  # a robot that blew up at once has learned nothing
                best[i] = taught
        done += len(part)
        if progress is not None:
            progress(done)
    controllers = (best[i] if i in best else initial_of(morphologies[i], scene, origins[i]) for i in range(n))
    return LearningResult(losses, tuple(controllers), status)


def _by_steps(
    bodies: Sequence[Morphology],
    initial: Sequence[Controller],
    physics: Sequence[Physics],
    scene: Scene,
    iterations: int,
) -> tuple[FloatArray, list[Controller], IntArray]:
    from eldir.engine import batch

    outcome = batch.run_batch(bodies, initial, scene, physics, iterations=iterations, backward=True)
    return outcome.losses, outcome.batch.controllers(outcome.best), outcome.status


_TEACH = {"steps": _by_steps, "adam": adam.teach}


def learning_paths(
    morphology: Morphology, scene: Scene, iterations: int, seed: int | Sequence[int], every: int = 1
) -> FloatArray:
    """Centres of mass [m] of one robot in the rollout before the first and after each update, every few
    steps and in the end: shape (iterations + 1, P, 2), NaN from where it blew up. It is taught as often
    as there are iterations, so that every rollout is the very one it learned from.
    """
    from eldir.engine import batch

    scene.require_controller()
    initial = initial_controllers([morphology], scene, seed)
    states = np.union1d(np.arange(0, scene.steps, every), scene.steps)
    paths = np.full((iterations + 1, len(states), 2), np.nan)
    for i in range(iterations + 1):
        outcome = batch.run_batch([morphology], initial, scene, iterations=i, backward=i > 0, record=True)
        if outcome.status[0] >= 0:
            break
        paths[i] = outcome.states(0)[0].mean(axis=1)[states]
    return paths
