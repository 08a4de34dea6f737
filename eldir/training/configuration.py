"""The configuration of training: the optimiser with its update rule, the length of its updates, and which
results count."""

from __future__ import annotations

from typing import Annotated, Any, Protocol

import numpy as np
from pydantic import Field

from eldir.core.records import FloatArray, Record, record
from eldir.defaults import OPTIMISER, UPDATE_LENGTHS, Optimiser
from eldir.scene import Scene

DERIVED: Any = None
"""Default of a field that `__post_init__` derives from other fields."""
_OF_SCENES: dict[str, dict[str, Any]] = {"released-main": {"jump_threshold": 1.0}}
_MIN_NORM = 1e-6  # keeps the gradient's norm from dividing by zero, as in the engine's kernel
_DECAY, _DECAY_SQUARE = 0.9, 0.999  # of Adam's two moving averages in one update
_MIN_ROOT = 1e-8


class Rule(Protocol):
    """One robot's update rule, with its state."""

    def update(self, gradient: FloatArray) -> FloatArray:
        """The update, which is subtracted from the weights, shape (weights,)."""


class FixedLength:
    """Updates of one length against the gradient, as in the paper. It has no state."""

    def __init__(self, length: float, weights: int) -> None:
        self._length = length

    def update(self, gradient: FloatArray) -> FloatArray:
        """The update, which is subtracted from the weights, shape (weights,)."""
        return self._length * gradient / (np.linalg.norm(gradient) + _MIN_NORM)


class Adam:
    """Kingma and Ba (2015), Algorithm 1.

    The first update has about the given length: the learning rate is the length over the square root of the
    number of weights.
    """

    def __init__(self, length: float, weights: int) -> None:
        self._rate = length / np.sqrt(weights)
        self._mean, self._square = np.zeros(weights), np.zeros(weights)
        self._updates = 0

    def update(self, gradient: FloatArray) -> FloatArray:
        """The update, which is subtracted from the weights, shape (weights,)."""
        self._updates += 1
        self._mean += (1 - _DECAY) * (gradient - self._mean)
        self._square += (1 - _DECAY_SQUARE) * (gradient * gradient - self._square)
        scale = np.sqrt(self._square / (1 - _DECAY_SQUARE**self._updates)) + _MIN_ROOT
        return self._rate * self._mean / (1 - _DECAY**self._updates) / scale


_RULES: dict[Optimiser, type[FixedLength] | type[Adam]] = {"steps": FixedLength, "adam": Adam}


@record
class TrainingConfig(Record):
    """Configuration of learning: how controllers are trained, and which results are valid.

    The loss and its gradient belong to the scene, and so does `Scene.window`.
    """

    optimiser: Optimiser = OPTIMISER
    """"steps": updates of one length against the gradient, as in the paper. "adam": Kingma and Ba (2015)."""
    update_length: Annotated[float, Field(gt=0)] = DERIVED
    """Euclidean length of an update; with Adam, of the first one. Default: 0.2 for "steps", 2 for "adam"."""
    jump_threshold: Annotated[float, Field(gt=0)] = 0.5
    """A robot whose loss changes by more than this between two iterations is discarded as unstable [m]."""

    def __post_init__(self) -> None:
        if self.update_length is None:
            object.__setattr__(self, "update_length", UPDATE_LENGTHS[self.optimiser])

    @classmethod
    def of(cls, scene: Scene) -> TrainingConfig:
        """The defaults of a scene's preset: "released-main" has a `jump_threshold` of 1 m, all others have
        the defaults of this class."""
        return cls(**_OF_SCENES.get(scene.name, {}))

    def rule(self, weights: int) -> Rule:
        """A new update rule for one robot with so many weights."""
        return _RULES[self.optimiser](self.update_length, weights)
