"""Teaching by Adam instead of steps of one length (Kingma and Ba, 2015, Algorithm 1).

The paper lists adaptive learning among what may help. Gradients come from the engine; the first update
of a robot is about as long as the paper's: its rate is the scene's update length over the square root of
the number of its weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.controller import Controller
from eldir.core.records import FloatArray, IntArray
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene

_FADING, _FADING_SQUARE = 0.9, 0.999  # of both moving averages in one update
_LEAST = 1e-8


class Adam:
    """One robot's moving averages."""

    def __init__(self, length: float, weights: int) -> None:
        self._rate = length / np.sqrt(weights)
        self._mean, self._square = np.zeros(weights), np.zeros(weights)
        self._updates = 0

    def update(self, gradient: FloatArray) -> FloatArray:
        """What to take from the weights, shape (weights,)."""
        self._updates += 1
        self._mean += (1 - _FADING) * (gradient - self._mean)
        self._square += (1 - _FADING_SQUARE) * (gradient * gradient - self._square)
        scale = np.sqrt(self._square / (1 - _FADING_SQUARE**self._updates)) + _LEAST
        return self._rate * self._mean / (1 - _FADING**self._updates) / scale


def teach(
    morphologies: Sequence[Morphology],
    initial: Sequence[Controller],
    physics: Sequence[Physics],
    scene: Scene,
    iterations: int,
) -> tuple[FloatArray, list[Controller], IntArray]:
    """Losses (n, iterations + 1), the best weights of each robot, and its status, as from the engine."""
    from eldir.engine import batch

    n, kind = len(morphologies), np.float32 if scene.precision == "f32" else np.float64  # what it computes in
    losses, status = np.full((n, iterations + 1), np.inf), np.full(n, -1, np.int32)
    weights = [c.flat for c in initial]
    rules = [Adam(scene.update_length, len(w)) for w in weights]
    best = list(initial)
    learning = list(range(n))
    for i in range(iterations + 1):
        brains = [initial[r].shaped(weights[r].astype(kind)) for r in learning]
        bodies, owns = [morphologies[r] for r in learning], [physics[r] for r in learning]
        outcome = batch.run_batch(bodies, brains, scene, owns, backward=True)
        losses[learning, i], status[learning] = outcome.losses[:, 0], outcome.status
        slopes = outcome.batch.controllers(outcome.best)
        for r, brain, slope in zip(learning, brains, slopes, strict=True):
            if losses[r, i] < losses[r, :i].min(initial=np.inf):
                best[r] = brain
            weights[r] = weights[r] - rules[r].update(slope.flat)
        learning = [r for r in learning if status[r] < 0]  # one that blew up learns no more
        if not learning:
            break
    return losses, best, status
