"""The neural controller: a multi-layer perceptron with one hidden layer (paper, Sect. Neural control)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from eldir.core.arguments import require_shape
from eldir.core.records import Array, FloatArray, Record

HIDDEN = 32
CPGS = 10
_GAIN_1, _GAIN_2 = 2.0, 3.0  # of the scaled Xavier normal distribution


@dataclass(frozen=True, eq=False)
class Controller(Record):
    """Weights of one robot with M masses and A active springs.

    Inputs: the central pattern generators, then dx, dy, vx, vy of each mass. Outputs: the
    active springs in spring order.
    """

    w1: Annotated[FloatArray, Array("f8", HIDDEN, None)]
    """Weights of the hidden layer, shape (32, 10 + 4 M)."""
    b1: Annotated[FloatArray, Array("f8", HIDDEN)]
    """Biases of the hidden layer, shape (32,)."""
    w2: Annotated[FloatArray, Array("f8", None, HIDDEN)]
    """Weights of the output layer, shape (A, 32)."""
    b2: Annotated[FloatArray, Array("f8", None)]
    """Biases of the output layer, shape (A,)."""

    def __post_init__(self) -> None:
        self._set_array("w1", np.float64, (HIDDEN, None))
        self._set_array("b1", np.float64, (HIDDEN,))
        self._set_array("w2", np.float64, (None, HIDDEN))
        self._set_array("b2", np.float64, (len(self.w2),))

    @property
    def masses(self) -> int:
        """Number of masses M, computed from the number of inputs."""
        return (self.w1.shape[1] - CPGS) // 4

    @property
    def motors(self) -> int:
        """Number of active springs A, which is the number of outputs."""
        return len(self.w2)

    def require_fit(self, name: str, masses: int, motors: int) -> None:
        """Raise `InputError` unless this is a controller of a robot with so many masses and motors."""
        require_shape(f"w1 of {name}", self.w1.shape, (HIDDEN, CPGS + 4 * masses))
        require_shape(f"w2 of {name}", self.w2.shape, (motors, HIDDEN))

    @property
    def flat(self) -> FloatArray:
        """All weights in one row."""
        return np.concatenate([self.w1.ravel(), self.b1, self.w2.ravel(), self.b2])

    def shaped(self, values: FloatArray) -> Controller:
        """A controller of the same shape, with its weights in one row as in `flat`."""
        w1, b1, w2, b2 = np.split(values, np.cumsum([self.w1.size, HIDDEN, self.w2.size]))
        return Controller(w1.reshape(HIDDEN, -1), b1, w2.reshape(-1, HIDDEN), b2)

    def scaled(self, factor: float) -> Controller:
        """A controller with every weight multiplied by a factor."""
        return Controller(*(factor * w for w in (self.w1, self.b1, self.w2, self.b2)))

    @classmethod
    def random(
        cls, masses: int, motors: int, rng: np.random.Generator, released_springs: int | None = None
    ) -> Controller:
        """Random initial weights: normal, with the gain of a scaled Xavier distribution; biases are 0.

        With `released_springs` (the number of all springs) they are drawn as by the released
        code, whose network has two more inputs, constant 1, and an output for every spring:
        the weights of the constant inputs become the spread of the hidden bias.
        """
        inputs, outputs = CPGS + 4 * masses, motors
        if released_springs is not None:
            inputs, outputs = inputs + 2, released_springs
        scale_1 = _GAIN_1 * np.sqrt(2.0 / (HIDDEN + inputs))
        scale_2 = _GAIN_2 * np.sqrt(2.0 / (HIDDEN + outputs))
        w1, w2 = rng.standard_normal((HIDDEN, inputs)), rng.standard_normal((motors, HIDDEN))
        w1 *= scale_1
        w2 *= scale_2
        used = CPGS + 4 * masses
        return cls.construct(w1[:, :used].copy(), w1[:, used:].sum(axis=1), w2, np.zeros(motors))
