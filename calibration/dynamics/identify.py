"""Identifies a robot from films of it: which knobs, turned how far, make the prediction do what it did.

Nonlinear least squares with priors (a maximum a posteriori estimate): several starts, then a fit whose
derivatives are taken over turns as wide as what is not yet known, then intervals from the curvature and
from how the residuals hang together in time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from calibration.dynamics.divergence import without
from calibration.dynamics.evaluation import Evaluator
from calibration.dynamics.individual import own_names
from calibration.dynamics.linearisation import Linear
from calibration.dynamics.measurements import UNREAD, Bench
from calibration.dynamics.model_check import Goodness, goodness
from calibration.dynamics.problem import Problem
from calibration.dynamics.recording import Body, Recording, predict
from calibration.dynamics.residuals import Misfit, misfit
from calibration.dynamics.uncertainty import covariance
from eldir.core.records import FloatArray, Record
from eldir.parameters.uncertain import KNOBS, Specimen, specimen

CAMERA = 0.15e-3
"""Error of one coordinate of a mark, assumed before the residuals tell [m]."""
_ROUGH = (3e-3, 2e-3)  # of shape and walk while the start is sought [m]
_STARTS = 16
_FOLLOWED = ((4, 5), (2, 6))  # how many of the best starts are followed, by how many evaluations
_LONGER = 3  # times that a film of which landings decide a part is fitted anew
_FEW, _MORE = 0.1, 0.02  # of the frames: too few for that where the model fits, and enough for once more
_MEMORY = 10.0  # seconds over which what is left may hang together
_TURN = (0.03, 0.8)  # least and widest turn for slopes, in standard deviations of the prior
_SWING = 1e-3  # by which a turn should move the marks: wide against what landings leave to chance [m]
FARTHEST = 3.0
"""A knob is turned by no more standard deviations of its prior."""
Tell = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Fit(Record):
    """Where the knobs stand."""

    names: tuple[str, ...]
    z: FloatArray
    """In standard deviations of the prior, shape (knobs,)."""
    covariance: FloatArray
    """Shape (knobs, knobs)."""
    left: tuple[float, float]
    """Root mean square of what is not explained: of shape, and of walk per second [m]."""
    noise: tuple[float, float]
    """What it counts for: more, where neighbours in time are alike, and where landings decide [m]."""
    cost: float
    """Half the sum of squares, priors included, at that noise."""
    evaluations: int
    """Batches of specimens that were driven."""
    turns: FloatArray
    """Over which slopes were taken, shape (knobs,)."""
    goodness: Goodness


def identify(
    body: Body,
    recordings: Sequence[Recording],
    nominal: Specimen,
    names: Sequence[str] = tuple(KNOBS),
    *,
    bench: Bench = UNREAD,
    seed: int = 0,
    tell: Tell = lambda what, part: None,
) -> Fit:
    """The knobs at which predictions fit the recordings best, and how sure that is."""
    tell("starts", 0.0)
    first = [r.until(r.start + r.period) for r in recordings[:1]]
    rough = Evaluator(Problem(body, first, nominal, names, _ROUGH, np.full(len(names), _TURN[1]), bench))
    best = _starts(rough, seed, tell)
    problem = Problem(body, recordings, nominal, names, _ROUGH, np.full(len(names), 0.3), bench)
    return _rounds(problem, best, (6, 5, 5), rough.evaluations, tell)


def with_parts(
    body: Body,
    recordings: Sequence[Recording],
    nominal: Specimen,
    fit: Fit,
    *,
    bench: Bench = UNREAD,
    tell: Tell = lambda what, part: None,
) -> Fit:
    """The same fit gone on with, now with turns for every strip and between the springs."""
    own = own_names(body.morphology)
    z, turns = np.append(fit.z, np.zeros(len(own))), np.append(fit.turns, np.ones(len(own)))
    problem = Problem(body, recordings, nominal, (*fit.names, *own), fit.noise, turns, bench)
    return _rounds(problem, z, (4, 4), fit.evaluations, tell)


def _rounds(problem: Problem, z: FloatArray, rounds: Sequence[int], used: int, tell: Tell) -> Fit:
    """Fits of so many evaluations each, between which noise and turns are taken anew. Where landings turn out
    to decide the motion in some frames, the fit goes on with those before them, and then with all others."""
    fit, before = _fitted(problem, z, rounds, used, tell), 0.0
    for _ in range(_LONGER):
        kept = fit.goodness.kept
        share = float(np.concatenate(kept).mean())
        if share == 1.0 or (fit.goodness.fits and share > 1 - _FEW) or share < before + _MORE:
            break
        if before == 0.0:
            kept = tuple(np.logical_and.accumulate(k) for k in kept)
            share = float(np.concatenate(kept).mean())
        before, clear = share, replace(problem, recordings=without(problem.recordings, kept))
        fit = _fitted(replace(clear, noise=_ROUGH, turns=fit.turns), fit.z, rounds, fit.evaluations, tell)
        whole = replace(problem, noise=fit.noise, turns=fit.turns)
        linear = whole.linearise(fit.z)
        fit = replace(fit, goodness=_judged(whole, linear, whole.chance(fit.z, linear)))
    return fit


def _fitted(problem: Problem, z: FloatArray, rounds: Sequence[int], used: int, tell: Tell) -> Fit:
    for round_, evaluations in enumerate(rounds):
        tell("fit", (round_ + 0.5) / (len(rounds) + 1))
        evaluator = Evaluator(problem)
        found = _solve(evaluator, z, evaluations)
        step = found.x - z
        z, used = found.x, used + evaluator.evaluations
        linear = evaluator.linear(z)
        problem = replace(problem, noise=_noise(problem, linear), turns=_turns(linear))
    tell("intervals", 0.9)
    linear = problem.linearise(z)  # over the last turns
    chance = problem.chance(z, linear)
    # A fit that still moved in its last round is not surer than that.
    widths = covariance(problem, z, linear, chance) + np.outer(step, step)
    cost = 0.5 * float((problem.residuals(z, linear.positions) ** 2).sum())
    left, fits = _left(problem, linear), _judged(problem, linear, chance)
    names = tuple(problem.names)
    return Fit(names, z, widths, left, problem.noise, cost, used + 1, problem.turns, fits)


def _judged(problem: Problem, linear: Linear, chance: Sequence[Misfit]) -> Goodness:
    return goodness(problem.recordings, linear.positions, [m.shape for m in chance])


def _left(problem: Problem, linear: Linear) -> tuple[float, float]:
    rest = problem.misfits(linear.positions)
    return _root_mean_square([m.shape for m in rest]), _root_mean_square([m.walk for m in rest])


def _root_mean_square(values: Sequence[FloatArray]) -> float:
    """Of those that are there."""
    every = np.concatenate([v[v != 0] for v in values])
    return float(np.sqrt(np.mean(every**2)))


def _solve(evaluator: Evaluator, z: FloatArray, evaluations: int) -> OptimizeResult:
    return least_squares(
        evaluator.residuals, z, evaluator.jacobian, method="trf", max_nfev=evaluations, loss="soft_l1",
        f_scale=3.0, bounds=(-FARTHEST, FARTHEST), xtol=1e-3, ftol=1e-3, gtol=1e-6,
    )  # fmt: skip


def _starts(evaluator: Evaluator, seed: int, tell: Tell) -> FloatArray:
    """The best of some places drawn from the prior, the nearest to the tracks followed a little way, and of
    these the best ones farther."""
    problem = evaluator.problem
    rng = np.random.default_rng(seed)
    places = np.concatenate(
        [
            np.zeros((1, len(problem.names))),
            rng.standard_normal((_STARTS - 1, len(problem.names))).clip(-2, 2),
        ]
    )
    tried = [specimen(problem.nominal, problem.names, z) for z in places]
    motions = predict(problem.body, problem.recordings, tried)
    costs = [_cost(problem, [x[i] for x in motions], z) for i, z in enumerate(places)]
    best = [places[i] for i in np.argsort(costs)]
    for part, (count, evaluations) in enumerate(_FOLLOWED, start=1):
        ends = [_solve(evaluator, z, evaluations) for z in best[:count]]
        best = [end.x for end in sorted(ends, key=lambda end: float(end.cost))]
        tell("starts", part / len(_FOLLOWED))
    return best[0]


def _cost(problem: Problem, positions: Sequence[FloatArray], z: FloatArray) -> float:
    squares = np.concatenate([m.scaled(*problem.noise) for m in problem.misfits(positions)]) ** 2
    return float(np.sqrt(1 + squares / 9).sum() + z @ z / 2)


def _turns(linear: Linear) -> FloatArray:
    """So wide that each knob moves the marks by a millimetre, if its prior allows that, shape (knobs,)."""
    squares = np.array([(s**2).mean(axis=(1, 2, 3)) for s in linear.slopes])
    return np.clip(_SWING / np.sqrt(squares.mean(axis=0) + 1e-30), *_TURN)


def _noise(problem: Problem, linear: Linear) -> tuple[float, float]:
    """What is left, and what landings leave to chance in the robot and in its prediction, of both kinds."""
    left = problem.misfits(linear.positions)
    times = problem.recordings[0].tracked.times
    rate = (len(times) - 1) / (times[-1] - times[0])
    chance = [misfit(r, x) for r, x in zip(problem.recordings, linear.repeats, strict=True)]
    return (
        _size([m.shape for m in left], [m.shape for m in chance], round(_MEMORY * rate)),
        _size([m.walk for m in left], [m.walk for m in chance], round(_MEMORY)),
    )


def _size(left: Sequence[FloatArray], chance: Sequence[FloatArray], memory: int) -> float:
    """Root mean square, larger where neighbours in time are alike: they are then not so many witnesses."""
    squares = [_root_mean_square(kind) ** 2 for kind in (left, chance)]
    alike = 1.0
    total = sum(float((v**2).sum()) for v in left)
    for lag in range(1, memory + 1):
        product = sum(float((v[lag:] * v[:-lag]).sum()) for v in left)
        alike += 2 * (1 - lag / (memory + 1)) * product / total
    return max(CAMERA / 3, float(np.sqrt(squares[0] * max(alike, 1.0) + squares[1])))
