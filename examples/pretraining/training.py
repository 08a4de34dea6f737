"""Training of the universal controller: the mean gradient over many bodies, and Adam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from universal import UniversalController

import eldir
from eldir.genotype import random_genotypes
from eldir.morphology import develop_all

SCENE = eldir.Scene.preset("paper")
_TRAINING = SCENE.replace(window=333)  # chaos dominates gradients of all 999 steps in many bodies
_DECAY, _DECAY_SQUARE = 0.9, 0.98


class Trainer:
    """A universal controller, and the state of Adam."""

    def __init__(self, controller: UniversalController, rate: float) -> None:
        self.controller, self._rate = controller, rate
        self._mean = self._square = np.zeros_like(controller.flat)
        self._updates = 0

    def update(self, bodies: Sequence[eldir.Morphology], factor: float = 1.0) -> np.ndarray:
        """One update against the mean gradient; returns the losses before it [m]. `factor` is one on the
        rate."""
        losses, gradients = eldir.loss_and_gradient(
            bodies, [self.controller.controller(body) for body in bodies], _TRAINING
        )
        shared = [self.controller.gradient(*pair).flat for pair in zip(bodies, gradients, strict=True)]
        # Each body counts as much: otherwise the few whose gradients chaos made large would decide. Gradients
        # of robots that diverged are zero.
        g = np.mean([v / (np.linalg.norm(v) + 1e-9) for v in shared], axis=0)
        self._updates += 1
        self._mean = _DECAY * self._mean + (1 - _DECAY) * g
        self._square = _DECAY_SQUARE * self._square + (1 - _DECAY_SQUARE) * g * g
        mean = self._mean / (1 - _DECAY**self._updates)
        root = np.sqrt(self._square / (1 - _DECAY_SQUARE**self._updates)) + 1e-8
        self.controller = self.controller.shaped(self.controller.flat - factor * self._rate * mean / root)
        return losses


def pretrain(
    trainer: Trainer, lattice: eldir.Lattice, updates: int, bodies: int, rng: np.random.Generator
) -> list[float]:
    """Train with new random bodies in every update; returns their mean walk before each [m]. The rate rises
    for ten updates, and falls to zero."""
    walked = []
    for k in range(updates):
        factor = min(1.0, (k + 1) / 10) * (1 + np.cos(np.pi * k / updates)) / 2
        losses = trainer.update(random_bodies(lattice, bodies, rng), factor)
        walked.append(-float(losses[np.isfinite(losses)].mean()))
    return walked


def walks(controller: UniversalController, bodies: Sequence[eldir.Morphology]) -> np.ndarray:
    """How far each body walks [m]; minus infinity if it diverged."""
    return -eldir.losses(bodies, [controller.controller(body) for body in bodies], SCENE)


def random_bodies(lattice: eldir.Lattice, n: int, rng: np.random.Generator) -> list[eldir.Morphology]:
    """Bodies of random genotypes."""
    return develop_all(lattice, random_genotypes(lattice, n, rng))


def save(controller: UniversalController, file: Path) -> None:
    """Write a file without pickled objects."""
    np.savez(file, **{f.name: getattr(controller, f.name) for f in fields(controller)})


def load(file: Path) -> UniversalController:
    """The inverse of `save`."""
    with np.load(file, allow_pickle=False) as saved:
        return UniversalController(*(saved[f.name] for f in fields(UniversalController)))
