"""The work that every program is given: robots, their first controllers, and how often they learn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eldir.benchmark.measurement import POPULATIONS
from eldir.controller import Controller
from eldir.core.records import FloatArray
from eldir.engine.pack import place
from eldir.morphology import Bodies, Morphology
from eldir.rollout import loss_and_gradient
from eldir.scene import Scene
from eldir.training.configuration import TrainingConfig
from eldir.training.loop import initial_controllers

_WEIGHTS = ("w1", "b1", "w2", "b2")


@dataclass(frozen=True)
class Task:
    """Robots that learn in one scene."""

    scene: Scene
    bodies: list[Morphology]
    controllers: list[Controller]
    iterations: int
    losses: FloatArray
    """First losses of the engine in float64 [m], shape (n,): what every program is held against."""
    gradients: list[Controller]
    """Gradients of these."""

    @property
    def update_length(self) -> float:
        return TrainingConfig.of(self.scene).update_length

    def start(self, i: int) -> FloatArray:
        """Positions of a robot's masses after placement on the ground [m], shape (M, 2)."""
        return place(Bodies([self.bodies[i]]), self.scene)

    def save(self, path: Path) -> None:
        """Everything for a program in a process of its own; arrays of a robot end with its number."""
        arrays: dict[str, FloatArray] = {
            "iterations": np.array(self.iterations),
            "update_length": np.array(self.update_length),
            "ground": self.scene.terrain.height(np.array(0.0)),
        }
        for name in ("steps", "dt", "gravity", "damping", "stiffness", "actuation", "omega"):
            arrays[name] = np.array(getattr(self.scene, name))
        for i, (body, brain) in enumerate(zip(self.bodies, self.controllers, strict=True)):
            arrays[f"start{i}"] = self.start(i)
            for name in ("positions", "springs", "rest_lengths", "active"):
                arrays[f"{name}{i}"] = getattr(body, name)
            for name in _WEIGHTS:
                arrays[f"{name}{i}"] = getattr(brain, name)
        np.savez(path, allow_pickle=False, **arrays)  # type: ignore[arg-type]

    def saved_gradients(self, path: Path) -> list[Controller]:
        """Gradients that such a program has written, named as controllers are in `save`."""
        with np.load(path) as found:
            return [Controller(*(found[f"{name}{i}"] for name in _WEIGHTS)) for i in range(len(self.bodies))]


def make_task(kind: str, robots: int, iterations: int, scene: Scene) -> Task:
    """Robots of `eldir benchmark speed`, with random controllers. Big: 176 springs on average, 208 in
    the first twelve; small: 62."""
    bodies = POPULATIONS[kind](robots)
    controllers = initial_controllers(bodies, scene, 0)
    losses, gradients = loss_and_gradient(bodies, controllers, scene.replace(precision="f64"))
    return Task(scene, bodies, controllers, iterations, losses, gradients)
