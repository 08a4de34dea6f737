"""Teaching one controller many robots at once: domain randomisation.

Every update goes against the mean gradient over some robots of the same body whose physics are drawn anew
(`eldir.training.randomisation`). What a robot learns depends on its body and its seed alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldir.controller import Controller
from eldir.core.records import FloatArray, Record
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.rollout import loss_and_gradient
from eldir.scene import Scene
from eldir.training.adam import Adam
from eldir.training.initial import initial_controllers
from eldir.training.randomisation import Doubt

_LEAST = 1e-6  # keeps the gradient's norm from dividing by zero
_ROBOTS_A_CALL = 64  # what they are taught does not depend on it


@dataclass(frozen=True, eq=False)
class RobustResult(Record):
    """What n robots learned."""

    losses: FloatArray
    """Mean over the robots drawn, before the first and after each update [m], shape (n, iterations + 1);
    infinite from where one of them blew up."""
    controllers: tuple[Controller, ...]
    """The weights with the least loss of each robot."""


def learn_robustly(
    morphologies: Sequence[Morphology],
    scene: Scene,
    doubt: Doubt,
    iterations: int,
    seeds: Sequence[int],
    controllers: Sequence[Controller] | None = None,
) -> RobustResult:
    """Teach every robot for some iterations, each by draws from its own seed; `controllers` replace the
    random initial weights, which also come from the seeds."""
    initial = initial_controllers(morphologies, scene, seeds) if controllers is None else list(controllers)
    # A drawn robot may be stiffer than the scene's step allows.
    finer = scene.replace(large_step="subdivide")
    losses = np.full((len(morphologies), iterations + 1), np.inf)
    best: list[Controller] = []
    for first in range(0, len(morphologies), _ROBOTS_A_CALL):
        part = slice(first, first + _ROBOTS_A_CALL)
        losses[part], taught = _teach(
            morphologies[part], finer, doubt, iterations, seeds[part], initial[part]
        )
        best += taught
    return RobustResult(losses, tuple(best))


def _teach(
    bodies: Sequence[Morphology],
    scene: Scene,
    doubt: Doubt,
    iterations: int,
    seeds: Sequence[int],
    initial: Sequence[Controller],
) -> tuple[FloatArray, list[Controller]]:
    kind = np.float32 if scene.precision == "f32" else np.float64  # what the engine computes in
    losses = np.full((len(bodies), iterations + 1), np.inf)
    weights, best = [c.flat for c in initial], list(initial)
    rules = [Adam(scene.update_length, len(w)) for w in weights]
    learning = list(range(len(bodies)))
    for i in range(iterations + 1):
        brains = {r: initial[r].shaped(weights[r].astype(kind)) for r in learning}
        owns: list[Physics] = [
            own for r in learning for own in doubt.draws_of(bodies[r], scene, int(seeds[r]), i)
        ]
        drawn = [r for r in learning for _ in range(doubt.draws)]
        found, slopes = loss_and_gradient([bodies[r] for r in drawn], [brains[r] for r in drawn], scene, owns)
        losses[learning, i] = found.reshape(-1, doubt.draws).mean(axis=1)
        for k, r in enumerate(learning):
            if losses[r, i] < losses[r, :i].min(initial=np.inf):
                best[r] = brains[r]
            own = slopes[k * doubt.draws : (k + 1) * doubt.draws]
            mean = np.mean([s.flat for s in own], axis=0)
            if scene.optimiser == "adam":
                weights[r] = weights[r] - rules[r].update(mean)
            else:
                weights[r] = weights[r] - scene.update_length * mean / (np.linalg.norm(mean) + _LEAST)
        learning = [r for r in learning if np.isfinite(losses[r, i])]
        if not learning:
            break
    return losses, best
