"""Solves an identification problem: starting points, trust-region least squares, and the uncertainty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from eldir.core.records import FloatArray
from eldir.parameters.uncertain import is_unobservable
from eldir_calibration.dynamics._problem import Linearisation, Problem, Residual, compute_residual
from eldir_calibration.dynamics.recording import Progress, predict_markers


class CachedProblem:
    """Evaluates one problem, with tangents of coarse robots. Its only state is a count, and what was
    simulated last: optimisers ask for residuals and gradients at the same point."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.evaluations = 0
        """Number of batches of robots simulated for residuals and gradients."""
        self._around: tuple[FloatArray, list[FloatArray]] | None = None
        self._linear: tuple[FloatArray, Linearisation] | None = None

    def residuals(self, z: FloatArray) -> FloatArray:
        """Residuals at `z` in standard deviations, shape (values,)."""
        return self.problem.residuals(z, [x[0] for x in self._motions_around(z)])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Derivatives of the residuals at `z`, shape (values, parameters)."""
        return self.problem.jacobian(z, self.linearise(z))

    def linearise(self, z: FloatArray) -> Linearisation:
        """The linearisation at `z`."""
        if self._linear is None or not np.array_equal(self._linear[0], z):
            self.evaluations += 1
            self._linear = z.copy(), self.problem.linearise(z, self._motions_around(z), coarse=True)
        return self._linear[1]

    def _motions_around(self, z: FloatArray) -> list[FloatArray]:
        if self._around is None or not np.array_equal(self._around[0], z):
            self.evaluations += 1
            self._around = z.copy(), self.problem.around(z)
        return self._around[1]


def find_start(cached: CachedProblem, seed: int, progress: Progress) -> FloatArray:
    """The best of several samples of the prior: the points nearest to the tracks are fitted a
    little, and the best of these more."""
    problem, config = cached.problem, cached.problem.config
    rng = np.random.default_rng(seed)
    samples = rng.standard_normal((config.starts - 1, len(problem.names)))
    points = np.concatenate(
        [np.zeros((1, len(problem.names))), samples.clip(-config.start_limit, config.start_limit)]
    )
    robots = [problem.nominal.at(problem.names, z) for z in points]
    motions = predict_markers(problem.body, problem.recordings, robots)
    costs = [_robust_cost(problem, [x[i] for x in motions], z) for i, z in enumerate(points)]
    best = [points[i] for i in np.argsort(costs)]
    for part, (count, evaluations) in enumerate(config.refinement_stages, start=1):
        solutions = [solve_least_squares(cached, z, evaluations) for z in best[:count]]
        best = [solution.x for solution in sorted(solutions, key=lambda solution: float(solution.cost))]
        progress("starts", part / len(config.refinement_stages))
    return best[0]


def solve_least_squares(cached: CachedProblem, z: FloatArray, evaluations: int) -> OptimizeResult:
    """Trust-region least squares from `z`, with at most so many evaluations."""
    s = cached.problem.config
    return least_squares(
        cached.residuals, z, cached.jacobian, method="trf", max_nfev=evaluations, loss="soft_l1",
        f_scale=s.loss_scale, bounds=(-s.z_limit, s.z_limit), xtol=s.tolerance, ftol=s.tolerance,
        gtol=s.gradient_tolerance,
    )  # fmt: skip


def _robust_cost(problem: Problem, positions: Sequence[FloatArray], z: FloatArray) -> float:
    squares = np.concatenate([r.scale(*problem.noise) for r in problem.track_residuals(positions)]) ** 2
    return float(np.sqrt(1 + squares / problem.config.loss_scale**2).sum() + z @ z / 2)


def estimate_covariance(
    problem: Problem, z: FloatArray, linear: Linearisation, divergence: Sequence[Residual]
) -> FloatArray:
    """Covariance of z, shape (P, P): Gauss and Newton's, widened for residuals that are correlated in time
    (Newey and West 1987) and for what landings leave to chance (`divergence`, of slightly perturbed
    robots)."""
    prior = problem.prior_jacobian(z)
    tangents = problem.jacobian(z, linear)[: -len(prior)]
    residuals = problem.residuals(z, linear.positions)[: -len(prior)]
    hessian = _subtract_divergence(problem, tangents.T @ tangents, linear) + prior.T @ prior
    bread = np.linalg.inv(hessian)
    meat = prior.T @ prior
    first, memory = 0, round(problem.config.correlation_time)
    for r in problem.recordings:
        frames, markers = r.tracked.positions.shape[:2]
        seconds = int(r.tracked.times[-1]) - int(r.tracked.times[0])
        second = (r.tracked.times - r.tracked.times[0]).astype(int)
        scores = np.zeros((seconds + 1, len(z)))
        size = frames * 2 * markers
        own = (tangents[first : first + size] * residuals[first : first + size, None]).reshape(
            frames, -1, len(z)
        )
        np.add.at(scores, np.minimum(second, seconds), own.sum(axis=1))
        first += size
        scores[1:] += tangents[first : first + seconds] * residuals[first : first + seconds, None]
        first += seconds
        meat += scores.T @ scores
        for lag in range(1, memory + 1):
            product = scores[lag:].T @ scores[:-lag]
            meat += (1 - lag / (memory + 1)) * (product + product.T)
    sandwich = bread @ meat @ bread
    # Standard deviations are at least those of white noise, and at most those of the prior.
    scale = np.sqrt(np.maximum(np.diag(sandwich), np.diag(bread)) / np.diag(bread))
    scale = np.minimum(scale, np.sqrt(1.0 / np.diag(bread)))
    gain = np.linalg.solve(tangents.T @ tangents + prior.T @ prior, tangents.T)
    return bread * np.outer(scale, scale) + _divergence_covariance(divergence, problem.noise, gain)


def _divergence_covariance(
    divergence: Sequence[Residual], noise: tuple[float, float], gain: FloatArray
) -> FloatArray:
    """Covariance of z caused by diverging landings and by nonlinear motion, from slightly perturbed robots.

    Both displace markers for seconds, so they do not average out as noise does. `gain` is the change of z
    per residual.
    """
    changes = np.concatenate([m.scale(*noise) for m in divergence], axis=1) @ gain.T
    return changes.T @ changes / len(changes)


def _subtract_divergence(problem: Problem, hessian: FloatArray, linear: Linearisation) -> FloatArray:
    """The curvature without the contribution of divergence to the tangents: a parameter without effect must
    not seem known."""
    divergence = 0.0
    for r, repeats in zip(problem.recordings, linear.divergence, strict=True):
        rows = compute_residual(r, repeats).scale(*problem.noise)
        divergence += float((rows**2).sum(axis=1).mean()) / 2  # each is the difference of two
    observable = np.array([not is_unobservable(n) for n in problem.names])
    curvature = np.diag(hessian)
    from_divergence = observable * divergence / (2 * problem.step_widths**2)
    factor = np.sqrt(
        np.clip(
            1 - np.divide(from_divergence, curvature, out=np.zeros_like(curvature), where=curvature > 0),
            0.0,
            1.0,
        )
    )
    return hessian * np.outer(factor, factor)
