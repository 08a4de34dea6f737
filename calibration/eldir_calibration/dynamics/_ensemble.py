"""Ensemble Kalman inversion: from parameters that may be the true ones to those that explain data.

Iglesias, Law and Stuart, Ensemble Kalman methods for inverse problems, Inverse Problems 29 (2013) 045001. The
data enter in several steps, each of which uses a share of their information, because predictions are not
linear in the parameters: Iglesias and Yang, Adaptive regularisation for ensemble Kalman inversion, Inverse
Problems 37 (2021) 025008. The shares add up to 1.
"""

from __future__ import annotations

import numpy as np

from eldir.core.records import FloatArray


def next_share(squares: FloatArray, data: float, left: float) -> float:
    """The share of the information that the next step uses, at most `left`.

    `squares`: of each member the sum of its squared residuals, in standard deviations, shape (N,). `data`:
    number of independent data.
    """
    potential = squares / 2
    spread = float(potential.var())
    by_mean = data / max(2 * float(potential.mean()), 1e-300)
    by_spread = np.sqrt(data / (2 * spread)) if spread > 0 else np.inf
    return float(min(max(by_mean, by_spread), left))


def update(z: FloatArray, residuals: FloatArray, share: float, rng: np.random.Generator) -> FloatArray:
    """The members after a step that uses a `share` of the information in the data, shape (N, P).

    `z`: members before, shape (N, P). `residuals`: data less each member's prediction, in standard deviations
    of independent errors, shape (N, D). The data are perturbed for each member, so that the spread of the
    members is that of the parameters after the step. Matrices are N x N, however many data there are.
    Sums over data are no products of BLAS, whose rounding depends on the number of threads.
    """
    members = len(z)
    predictions = -(residuals - residuals.mean(axis=0)) / np.sqrt(members - 1)
    deviations = (z - z.mean(axis=0)) / np.sqrt(members - 1)
    perturbed = residuals + rng.standard_normal(residuals.shape) / np.sqrt(share)
    covariance = _products(predictions, predictions) + np.eye(members) / share
    return z + _products(perturbed, predictions) @ np.linalg.solve(covariance, deviations)


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    """a @ b.T, shape (N, N)."""
    return np.einsum("id,jd->ij", a, b)
