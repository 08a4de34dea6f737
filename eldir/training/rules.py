"""Update rules: how far and in which direction one gradient moves the weights of one robot."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from eldir.core.records import FloatArray

_LEAST_NORM = 1e-6  # keeps the gradient's norm from dividing by zero, as in the engine's kernel
_DECAY, _DECAY_SQUARE = 0.9, 0.999  # of Adam's two moving averages in one update
_LEAST_ROOT = 1e-8


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
        return self._length * gradient / (np.linalg.norm(gradient) + _LEAST_NORM)


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
        scale = np.sqrt(self._square / (1 - _DECAY_SQUARE**self._updates)) + _LEAST_ROOT
        return self._rate * self._mean / (1 - _DECAY**self._updates) / scale
