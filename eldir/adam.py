"""Teaching by Adam instead of steps of one length (Kingma and Ba, 2015, Algorithm 1).

The paper lists adaptive learning among what may help. Gradients come from the engine; the first update
of a robot is about as long as the paper's: its rate is the scene's update length over the square root of
the number of its weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.controller import HIDDEN, Controller
from eldir.frozen import FloatArray, IntArray
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene

_FADING, _FADING_SQUARE = 0.9, 0.999  # of both moving averages in one update
_LEAST = 1e-8


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
    weights = [_flat(c) for c in initial]
    mean = [np.zeros_like(w) for w in weights]
    square = [np.zeros_like(w) for w in weights]
    best = list(initial)
    learning = list(range(n))
    for i in range(iterations + 1):
        brains = [_shaped(weights[r].astype(kind), initial[r]) for r in learning]
        bodies, owns = [morphologies[r] for r in learning], [physics[r] for r in learning]
        outcome = batch.run(bodies, brains, scene, owns, backward=True)
        losses[learning, i], status[learning] = outcome.losses[:, 0], outcome.status
        slopes = outcome.batch.controllers(outcome.best)
        for r, brain, slope in zip(learning, brains, slopes, strict=True):
            if losses[r, i] < losses[r, :i].min(initial=np.inf):
                best[r] = brain
            g = _flat(slope)
            mean[r] += (1 - _FADING) * (g - mean[r])
            square[r] += (1 - _FADING_SQUARE) * (g * g - square[r])
            scale = np.sqrt(square[r] / (1 - _FADING_SQUARE ** (i + 1))) + _LEAST
            rate = scene.update_length / np.sqrt(len(g))
            weights[r] = weights[r] - rate * mean[r] / (1 - _FADING ** (i + 1)) / scale
        learning = [r for r in learning if status[r] < 0]  # one that blew up learns no more
        if not learning:
            break
    return losses, best, status


def _flat(c: Controller) -> FloatArray:
    return np.concatenate([c.w1.ravel(), c.b1, c.w2.ravel(), c.b2])


def _shaped(values: FloatArray, like: Controller) -> Controller:
    w1, b1, w2, b2 = np.split(values, np.cumsum([like.w1.size, HIDDEN, like.w2.size]))
    return Controller(w1.reshape(HIDDEN, -1), b1, w2.reshape(-1, HIDDEN), b2)
