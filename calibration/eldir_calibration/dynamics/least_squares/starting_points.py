"""Where a fit begins: points drawn from the priors, of which the nearest to the tracks are followed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from eldir.core.records import FloatArray
from eldir_calibration.dynamics.least_squares.evaluation import Evaluator
from eldir_calibration.dynamics.least_squares.problem import Problem
from eldir_calibration.dynamics.recording import predict_marks

Progress = Callable[[str, float], None]
"""Called with the present step and the fraction of it that is done, 0 to 1."""


def best_start(evaluator: Evaluator, seed: int, progress: Progress) -> FloatArray:
    """The best of several points drawn from the prior: the points nearest to the tracks are fitted a
    little, and the best of these more."""
    problem, settings = evaluator.problem, evaluator.problem.settings
    rng = np.random.default_rng(seed)
    drawn = rng.standard_normal((settings.starts - 1, len(problem.names)))
    points = np.concatenate(
        [np.zeros((1, len(problem.names))), drawn.clip(-settings.start_limit, settings.start_limit)]
    )
    robots = [problem.nominal.at(problem.names, z) for z in points]
    motions = predict_marks(problem.body, problem.recordings, robots)
    costs = [_cost(problem, [x[i] for x in motions], z) for i, z in enumerate(points)]
    best = [points[i] for i in np.argsort(costs)]
    for part, (count, evaluations) in enumerate(settings.followed, start=1):
        ends = [solve(evaluator, z, evaluations) for z in best[:count]]
        best = [end.x for end in sorted(ends, key=lambda end: float(end.cost))]
        progress("starts", part / len(settings.followed))
    return best[0]


def solve(evaluator: Evaluator, z: FloatArray, evaluations: int) -> OptimizeResult:
    """Trust-region least squares from `z`, with at most so many evaluations."""
    s = evaluator.problem.settings
    return least_squares(
        evaluator.residuals, z, evaluator.jacobian, method="trf", max_nfev=evaluations, loss="soft_l1",
        f_scale=s.loss_scale, bounds=(-s.z_limit, s.z_limit), xtol=s.tolerance, ftol=s.tolerance,
        gtol=s.gradient_tolerance,
    )  # fmt: skip


def _cost(problem: Problem, positions: Sequence[FloatArray], z: FloatArray) -> float:
    squares = np.concatenate([r.scaled(*problem.noise) for r in problem.track_residuals(positions)]) ** 2
    return float(np.sqrt(1 + squares / problem.settings.loss_scale**2).sum() + z @ z / 2)
