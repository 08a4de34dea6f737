"""Uncertainty of an identification, from the curvature and from the correlation of residuals in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.core.records import FloatArray
from eldir.parameters.uncertain import is_unobservable
from eldir_calibration.dynamics.least_squares.linearisation import Linearisation
from eldir_calibration.dynamics.least_squares.problem import Problem
from eldir_calibration.dynamics.least_squares.residuals import Residual, residual


def covariance(
    problem: Problem, z: FloatArray, linear: Linearisation, chance: Sequence[Residual]
) -> FloatArray:
    """Covariance of z, shape (P, P): Gauss and Newton's, widened for residuals that are correlated in time
    (Newey and West 1987) and for what landings leave to chance (`chance`, of slightly perturbed robots)."""
    known = problem.known_slopes(z)
    slopes = problem.jacobian(z, linear)[: -len(known)]
    residuals = problem.residuals(z, linear.positions)[: -len(known)]
    hessian = _less_chance(problem, slopes.T @ slopes, linear) + known.T @ known
    bread = np.linalg.inv(hessian)
    meat = known.T @ known
    first, memory = 0, round(problem.settings.correlation_time)
    for r in problem.recordings:
        frames, marks = r.tracked.positions.shape[:2]
        seconds = int(r.tracked.times[-1]) - int(r.tracked.times[0])
        second = (r.tracked.times - r.tracked.times[0]).astype(int)
        scores = np.zeros((seconds + 1, len(z)))
        size = frames * 2 * marks
        own = (slopes[first : first + size] * residuals[first : first + size, None]).reshape(
            frames, -1, len(z)
        )
        np.add.at(scores, np.minimum(second, seconds), own.sum(axis=1))
        first += size
        scores[1:] += slopes[first : first + seconds] * residuals[first : first + seconds, None]
        first += seconds
        meat += scores.T @ scores
        for lag in range(1, memory + 1):
            product = scores[lag:].T @ scores[:-lag]
            meat += (1 - lag / (memory + 1)) * (product + product.T)
    sandwich = bread @ meat @ bread
    # Neither less sure of anything than the residuals say, nor surer than white noise would allow; never
    # less sure than the prior.
    scale = np.sqrt(np.maximum(np.diag(sandwich), np.diag(bread)) / np.diag(bread))
    scale = np.minimum(scale, np.sqrt(1.0 / np.diag(bread)))
    answer = np.linalg.solve(slopes.T @ slopes + known.T @ known, slopes.T)
    return bread * np.outer(scale, scale) + _by_chance(chance, problem.noise, answer)


def _by_chance(chance: Sequence[Residual], noise: tuple[float, float], answer: FloatArray) -> FloatArray:
    """Covariance of z caused by other landings and by nonlinear motion, from slightly perturbed robots.

    Both displace marks for seconds, so they do not average out as noise does. `answer` is the change of z
    per residual.
    """
    moved = np.concatenate([m.scaled(*noise) for m in chance], axis=1) @ answer.T
    return moved.T @ moved / len(moved)


def _less_chance(problem: Problem, hessian: FloatArray, linear: Linearisation) -> FloatArray:
    """The curvature without the contribution of chance in landings to the slopes: a parameter that moves
    nothing must not seem known."""
    chance = 0.0
    for r, repeats in zip(problem.recordings, linear.repeats, strict=True):
        rows = residual(r, repeats).scaled(*problem.noise)
        chance += float((rows**2).sum(axis=1).mean()) / 2  # each is the difference of two
    observable = np.array([not is_unobservable(n) for n in problem.names])
    curvature = np.diag(hessian)
    by_chance = observable * chance / (2 * problem.step_widths**2)
    sound = np.sqrt(
        np.clip(
            1 - np.divide(by_chance, curvature, out=np.zeros_like(curvature), where=curvature > 0), 0.0, 1.0
        )
    )
    return hessian * np.outer(sound, sound)
