"""Fits the parameters of one joint model to films of a robot: nonlinear least squares with priors.

The result is a maximum a posteriori estimate: several starting points, then a fit whose derivatives are
differences over steps as wide as what is not yet known, then intervals from the curvature and from how the
residuals are correlated in time (docs/decisions/0021-identification.md).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eldir.core.records import BoolArray, FloatArray, Record
from eldir.parameters.robot import RobotParameters, part_names
from eldir.parameters.uncertain import PARAMETERS, parameters_of
from eldir_calibration.dynamics.least_squares.divergence import without
from eldir_calibration.dynamics.least_squares.evaluation import Evaluator
from eldir_calibration.dynamics.least_squares.linearisation import Linearisation
from eldir_calibration.dynamics.least_squares.problem import Problem
from eldir_calibration.dynamics.least_squares.residuals import Residual, residual
from eldir_calibration.dynamics.least_squares.starting_points import Progress, best_start, solve
from eldir_calibration.dynamics.least_squares.uncertainty import covariance
from eldir_calibration.dynamics.measurements import NOT_MEASURED, Measurements
from eldir_calibration.dynamics.model_check import ModelCheck, check_model
from eldir_calibration.dynamics.recording import FilmedBody, Recording
from eldir_calibration.dynamics.settings import DEFAULT_SETTINGS, IdentificationSettings
from eldir_calibration.dynamics.verdict import within_noise

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class DynamicsFit(Record):
    """Values of P parameters fitted to films, and their uncertainty."""

    names: tuple[str, ...]
    z: FloatArray
    """Values in standard deviations of the priors, shape (P,)."""
    covariance: FloatArray
    """Covariance of z, shape (P, P)."""
    left: tuple[float, float]
    """Root mean square of the residuals of shape, and of walk per second [m]."""
    noise: tuple[float, float]
    """Noise of shape and walk that the fit assumed [m]; larger where residuals are correlated in time or
    where landings decide the motion."""
    cost: float
    """Half the sum of squared residuals in units of that noise, priors included."""
    evaluations: int
    """Number of simulated batches of robots."""
    step_widths: FloatArray
    """Steps of z for the derivatives, shape (P,)."""
    check: ModelCheck
    start: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Values of the common parameters at which the fit began, in standard deviations of the priors."""


def fit_dynamics(
    body: FilmedBody,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    names: Sequence[str] = tuple(PARAMETERS),
    *,
    measurements: Measurements = NOT_MEASURED,
    seed: int = 0,
    progress: Progress = lambda what, part: None,
    settings: IdentificationSettings = DEFAULT_SETTINGS,
) -> DynamicsFit:
    """Find the parameter values whose predictions fit the recordings best, and their uncertainty."""
    progress("starts", 0.0)
    names = parameters_of(nominal.printed, names)
    first = [r.until(r.start + r.period) for r in recordings[:1]]
    wide, narrow = (np.full(len(names), w) for w in (settings.step_widths[1], settings.first_step))
    rough = Problem(body, first, nominal, names, settings.rough_noise, wide, measurements, settings)
    evaluator = Evaluator(rough)
    best = best_start(evaluator, seed, progress)
    problem = replace(rough, recordings=recordings, step_widths=narrow)
    return replace(
        _fit_with_gaps(problem, best, settings.rounds, evaluator.evaluations, progress), start=best
    )


def fit_joints(
    body: FilmedBody,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    other: DynamicsFit,
    names: Sequence[str] = tuple(PARAMETERS),
    *,
    measurements: Measurements = NOT_MEASURED,
    progress: Progress = lambda what, part: None,
    settings: IdentificationSettings = DEFAULT_SETTINGS,
) -> DynamicsFit:
    """Fit from the starting point of another fit, whose joints are cheaper and move a robot nearly alike."""
    names = parameters_of(nominal.printed, names)
    start = dict(zip(other.names, other.start, strict=False))
    z = np.array([start.get(name, 0.0) for name in names])
    narrow = np.full(len(names), settings.first_step)
    problem = Problem(body, recordings, nominal, names, settings.rough_noise, narrow, measurements, settings)
    return replace(_fit_with_gaps(problem, z, settings.joint_rounds, 0, progress), start=z)


def fit_parts(
    body: FilmedBody,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    fit: DynamicsFit,
    *,
    measurements: Measurements = NOT_MEASURED,
    progress: Progress = lambda what, part: None,
    settings: IdentificationSettings = DEFAULT_SETTINGS,
) -> DynamicsFit:
    """Continue a fit with lengths of strips and differences between springs as further parameters."""
    own = part_names(body.morphology)
    z = np.append(fit.z, np.zeros(len(own)))
    widths = np.append(fit.step_widths, np.full(len(own), settings.part_step))
    names = (*fit.names, *own)
    problem = Problem(body, recordings, nominal, names, fit.noise, widths, measurements, settings)
    return replace(
        _fit_with_gaps(problem, z, settings.part_rounds, fit.evaluations, progress), start=fit.start
    )


def _fit_with_gaps(
    problem: Problem, z: FloatArray, rounds: Sequence[int], used: int, progress: Progress
) -> DynamicsFit:
    """Fit; if landings decide the motion in some frames, fit again: first the frames before the first of
    them, then all others. A later fit may end in a worse place than an earlier one: the one is taken that
    leaves least in the frames that landings decide in none of them."""
    settings = problem.settings
    fit, places = _fit(problem, z, rounds, used, progress)
    fits, motions, fitted = [fit], [places], 1.0
    for attempt in range(settings.refits):
        kept, share = fit.check.kept, fit.check.share
        if share > 1 - settings.refit_share and within_noise(fit.check):
            break
        if attempt == 0 and share < 1.0:
            kept = _before_landings(kept)
            share = float(np.concatenate(kept).mean())
        elif share < fitted + settings.refit_gain:
            break
        fitted = share
        clear = replace(
            problem,
            recordings=without(problem.recordings, kept),
            noise=settings.rough_noise,
            step_widths=fit.step_widths,
        )
        fit, _ = _fit(clear, fit.z, rounds, fit.evaluations, progress)
        whole = replace(problem, noise=fit.noise, step_widths=fit.step_widths)
        linear = whole.linearise(fit.z)
        fit = replace(fit, check=_checked(whole, linear, whole.divergence(fit.z, linear)))
        fits.append(fit)
        motions.append(linear.positions)
    return replace(_best(problem, fits, motions), evaluations=fits[-1].evaluations)


def _best(
    problem: Problem, fits: Sequence[DynamicsFit], motions: Sequence[Sequence[FloatArray]]
) -> DynamicsFit:
    """The fit that leaves least in the frames that are reproducible in all of them, or of those that leave
    nearly as little, the one that is reproducible in most frames.

    A robot in a wrong place may be the only one whose motion no landing decides, so that alone is no reason
    to prefer it.
    """
    common = [np.logical_and.reduce(kept) for kept in zip(*(f.check.kept for f in fits), strict=True)]
    shared = without(problem.recordings, common)
    left = [check_model(shared, places, settings=problem.settings).left for places in motions]
    near = problem.settings.refit_near * min(left)
    return max(
        (f for f, own in zip(fits, left, strict=True) if own <= near),
        key=lambda f: (round(f.check.share / problem.settings.refit_gain), -f.check.unexplained),
    )


def _before_landings(kept: Sequence[BoolArray]) -> tuple[BoolArray, ...]:
    """The frames before the first that landings decide; if that is the very first one, all that they do not
    decide."""
    early = tuple(np.logical_and.accumulate(k) for k in kept)
    return early if any(k.any() for k in early) else tuple(kept)


def _fit(
    problem: Problem, z: FloatArray, rounds: Sequence[int], used: int, progress: Progress
) -> tuple[DynamicsFit, Sequence[FloatArray]]:
    """Fit in rounds of so many evaluations each; noise and step widths are estimated again between rounds.

    Returns the fit and its marks, (frames, marks, 2) [m] for each recording."""
    for round_, evaluations in enumerate(rounds):
        progress("fit", (round_ + 0.5) / (len(rounds) + 1))
        evaluator = Evaluator(problem)
        found = solve(evaluator, z, evaluations)
        step = found.x - z
        z, used = found.x, used + evaluator.evaluations
        linear = evaluator.linear(z)
        widths = _step_widths(linear, problem.settings)
        problem = replace(problem, noise=_noise(problem, linear), step_widths=widths)
        _logger.info(
            "round %d of %d: %d parameters, %d evaluations, noise %.2f and %.2f mm",
            round_ + 1, len(rounds), len(z), used, *(1e3 * n for n in problem.noise),
        )  # fmt: skip
    progress("intervals", 0.9)
    linear = problem.linearise(z)  # over the last step widths
    chance = problem.divergence(z, linear)
    # A fit that still moved in its last round is not surer than that.
    spread = covariance(problem, z, linear, chance) + np.outer(step, step)
    cost = 0.5 * float((problem.residuals(z, linear.positions) ** 2).sum())
    rest = problem.track_residuals(linear.positions)
    left = _root_mean_square([r.shape for r in rest]), _root_mean_square([r.walk for r in rest])
    check = _checked(problem, linear, chance)
    names = tuple(problem.names)
    fit = DynamicsFit(names, z, spread, left, problem.noise, cost, used + 1, problem.step_widths, check)
    return fit, linear.positions


def _checked(problem: Problem, linear: Linearisation, chance: Sequence[Residual]) -> ModelCheck:
    apart = [r.shape for r in chance]
    return check_model(problem.recordings, linear.positions, apart, settings=problem.settings)


def _root_mean_square(values: Sequence[FloatArray]) -> float:
    """Root mean square of the residuals that exist, 0 if none does; 0 marks a frame or second without one."""
    every = np.concatenate([v[v != 0] for v in values])
    return float(np.sqrt(np.mean(every**2))) if len(every) else 0.0


def _step_widths(linear: Linearisation, settings: IdentificationSettings) -> FloatArray:
    """Steps of z that move the marks by `step_motion`, within limits, shape (P,)."""
    squares = np.array([(s**2).mean(axis=(1, 2, 3)) for s in linear.slopes])
    return np.clip(settings.step_motion / np.sqrt(squares.mean(axis=0) + 1e-30), *settings.step_widths)


def _noise(problem: Problem, linear: Linearisation) -> tuple[float, float]:
    """Noise of shape and walk [m]: the residuals, and the chance of landings in the robot and in its
    prediction."""
    left = problem.track_residuals(linear.positions)
    times, memory = problem.recordings[0].tracked.times, problem.settings.correlation_time
    rate = (len(times) - 1) / (times[-1] - times[0])
    chance = [residual(r, x) for r, x in zip(problem.recordings, linear.repeats, strict=True)]
    least = problem.settings.camera_noise / 3
    return (
        max(least, _size([r.shape for r in left], [r.shape for r in chance], round(memory * rate))),
        max(least, _size([r.walk for r in left], [r.walk for r in chance], round(memory))),
    )


def _size(left: Sequence[FloatArray], chance: Sequence[FloatArray], memory: int) -> float:
    """Root mean square, enlarged where neighbours in time are correlated: fewer values are independent."""
    squares = [_root_mean_square(kind) ** 2 for kind in (left, chance)]
    alike = 1.0
    total = sum(float((v**2).sum()) for v in left)
    for lag in range(1, memory + 1) if total else ():
        product = sum(float((v[lag:] * v[:-lag]).sum()) for v in left)
        alike += 2 * (1 - lag / (memory + 1)) * product / total
    return float(np.sqrt(squares[0] * max(alike, 1.0) + squares[1]))
