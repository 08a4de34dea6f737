"""Evaluates a problem for an optimiser: residuals and slopes at z; the last linearisation is kept."""

from __future__ import annotations

import numpy as np

from eldir.core.records import FloatArray
from eldir_calibration.dynamics.least_squares.linearisation import Linearisation
from eldir_calibration.dynamics.least_squares.problem import Problem


class Evaluator:
    """Evaluates one problem. Its only state is a count, and the last linearisation: optimisers ask for
    residuals and slopes at the same place."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.evaluations = 0
        """Number of batches of robots simulated for residuals and slopes."""
        self._last: tuple[FloatArray, Linearisation] | None = None

    def residuals(self, z: FloatArray) -> FloatArray:
        """Residuals at `z` in standard deviations, shape (values,)."""
        linear = self._kept(z)
        if linear is not None:
            return self.problem.residuals(z, linear.positions)
        self.evaluations += 1
        return self.problem.residuals(z, self.problem.positions(z))

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Derivatives of the residuals at `z`, shape (values, parameters)."""
        return self.problem.jacobian(z, self.linear(z))

    def linear(self, z: FloatArray) -> Linearisation:
        """The linearisation at `z`."""
        linear = self._kept(z)
        if linear is None:
            self.evaluations += 1
            linear = self.problem.linearise(z)
            self._last = z.copy(), linear
        return linear

    def _kept(self, z: FloatArray) -> Linearisation | None:
        if self._last is not None and np.array_equal(self._last[0], z):
            return self._last[1]
        return None
