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
from eldir.parameters.uncertain import PARAMETERS, applicable_parameters
from eldir_calibration.dynamics._model_check import ModelCheck, check_model
from eldir_calibration.dynamics._problem import (
    Linearisation,
    Problem,
    Residual,
    compute_residual,
    mask_frames,
)
from eldir_calibration.dynamics._solution import (
    CachedProblem,
    estimate_covariance,
    find_start,
    solve_least_squares,
)
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig
from eldir_calibration.dynamics.recording import NOT_MEASURED, FilmedBody, Measurements, Progress, Recording
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
    rms: tuple[float, float]
    """Root mean square of the residuals of shape, and of walk per second [m]."""
    noise: tuple[float, float]
    """Noise of shape and walk that the fit assumed [m]; larger where residuals are correlated in time or
    simulations diverge."""
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
    config: IdentificationConfig = DEFAULT_CONFIG,
) -> DynamicsFit:
    """Find the parameter values whose predictions fit the recordings best, and their uncertainty."""
    progress("starts", 0.0)
    names = applicable_parameters(nominal.printed, names)
    first = [r.truncate(r.start + r.period) for r in recordings[:1]]
    wide, narrow = (np.full(len(names), w) for w in (config.step_widths[1], config.first_step))
    rough = Problem(body, first, nominal, names, config.rough_noise, wide, measurements, config)
    cached = CachedProblem(rough)
    best = find_start(cached, seed, progress)
    problem = replace(rough, recordings=recordings, step_widths=narrow)
    return replace(fit_reproducible(problem, best, config.rounds, cached.evaluations, progress), start=best)


def fit_joints(
    body: FilmedBody,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    other: DynamicsFit,
    names: Sequence[str] = tuple(PARAMETERS),
    *,
    measurements: Measurements = NOT_MEASURED,
    progress: Progress = lambda what, part: None,
    config: IdentificationConfig = DEFAULT_CONFIG,
) -> DynamicsFit:
    """Fit from the starting point of another fit, whose joints are cheaper and move a robot nearly alike."""
    names = applicable_parameters(nominal.printed, names)
    start = dict(zip(other.names, other.start, strict=False))
    z = np.array([start.get(name, 0.0) for name in names])
    narrow = np.full(len(names), config.first_step)
    problem = Problem(body, recordings, nominal, names, config.rough_noise, narrow, measurements, config)
    return replace(fit_reproducible(problem, z, config.joint_rounds, 0, progress), start=z)


def fit_parts(
    body: FilmedBody,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    fit: DynamicsFit,
    *,
    measurements: Measurements = NOT_MEASURED,
    progress: Progress = lambda what, part: None,
    config: IdentificationConfig = DEFAULT_CONFIG,
) -> DynamicsFit:
    """Continue a fit with lengths of strips and differences between springs as further parameters."""
    own = part_names(body.morphology)
    z = np.append(fit.z, np.zeros(len(own)))
    widths = np.append(fit.step_widths, np.full(len(own), config.part_step))
    names = (*fit.names, *own)
    problem = Problem(body, recordings, nominal, names, fit.noise, widths, measurements, config)
    return replace(
        fit_reproducible(problem, z, config.part_rounds, fit.evaluations, progress), start=fit.start
    )


def fit_reproducible(
    problem: Problem, z: FloatArray, rounds: Sequence[int], evaluations_before: int, progress: Progress
) -> DynamicsFit:
    """Fit the frames that can be predicted.

    If simulations diverge in some frames (contact-sensitive frames), fit again: first the frames before the
    first of them, then all others, in one round less, because it begins where the last one ended. A later
    fit may end at a worse point than an earlier one, so the fit with the smallest residuals in the common
    reproducible frames is selected.
    """
    config = problem.config
    fit, linear = _fit_rounds(problem, z, rounds, evaluations_before, progress)
    fits, motions, fitted = [fit], [linear.positions], 1.0
    for attempt in range(config.refits):
        reproducible, share = fit.check.reproducible, fit.check.reproducible_share
        if share > 1 - config.refit_share and within_noise(fit.check):
            break
        if attempt == 0 and share < 1.0:
            reproducible = frames_before_divergence(reproducible)
            share = float(np.concatenate(reproducible).mean())
        elif share < fitted + config.refit_gain:
            break
        fitted = share
        masked = replace(
            problem,
            recordings=mask_frames(problem.recordings, reproducible),
            noise=config.rough_noise,
            step_widths=fit.step_widths,
        )
        fit, linear = _fit_rounds(masked, fit.z, rounds[1:] or rounds, fit.evaluations, progress)
        whole = replace(problem, noise=fit.noise, step_widths=fit.step_widths)
        fit = replace(fit, check=_check_fit(whole, linear, whole.divergence(fit.z, linear)))
        fits.append(fit)
        motions.append(linear.positions)
    return replace(_select_fit(problem, fits, motions), evaluations=fits[-1].evaluations)


def _select_fit(
    problem: Problem, fits: Sequence[DynamicsFit], motions: Sequence[Sequence[FloatArray]]
) -> DynamicsFit:
    """The fit with the smallest residuals in the frames that are reproducible in all fits; of fits with
    nearly the same residuals, the one with the most reproducible frames.

    A wrong robot may be the only one without diverging landings, so that alone is no reason to prefer it.
    """
    common = [np.logical_and.reduce(kept) for kept in zip(*(f.check.reproducible for f in fits), strict=True)]
    shared = mask_frames(problem.recordings, common)
    rms = [check_model(shared, positions, config=problem.config).rms for positions in motions]
    limit = problem.config.refit_tolerance * min(rms)
    return max(
        (f for f, own in zip(fits, rms, strict=True) if own <= limit),
        key=lambda f: (round(f.check.reproducible_share / problem.config.refit_gain), -f.check.unexplained),
    )


def frames_before_divergence(kept: Sequence[BoolArray]) -> tuple[BoolArray, ...]:
    """The frames before the first contact-sensitive one; if that is the very first frame, all other
    frames."""
    early = tuple(np.logical_and.accumulate(k) for k in kept)
    return early if any(k.any() for k in early) else tuple(kept)


def _fit_rounds(
    problem: Problem, z: FloatArray, rounds: Sequence[int], evaluations_before: int, progress: Progress
) -> tuple[DynamicsFit, Linearisation]:
    """Fit in rounds of these numbers of evaluations; noise and step widths are estimated again between
    rounds.

    Returns the fit, and the linearisation at its end, which does not depend on the frames that are fitted."""
    for round_, evaluations in enumerate(rounds):
        progress("fit", (round_ + 0.5) / (len(rounds) + 1))
        cached = CachedProblem(problem)
        found = solve_least_squares(cached, z, evaluations)
        step = found.x - z
        z, evaluations_before = found.x, evaluations_before + cached.evaluations
        linear = cached.linearise(z)
        widths = _step_widths(linear, problem.config)
        problem = replace(problem, noise=_estimate_noise(problem, linear), step_widths=widths)
        _logger.info(
            "round %d of %d: %d parameters, %d evaluations, noise %.2f and %.2f mm",
            round_ + 1, len(rounds), len(z), evaluations_before, *(1e3 * n for n in problem.noise),
        )  # fmt: skip
    progress("intervals", 0.9)
    linear = problem.linearise(z)  # over the last step widths
    divergence = problem.divergence(z, linear)
    # The uncertainty is at least the step of the last round.
    spread = estimate_covariance(problem, z, linear, divergence) + np.outer(step, step)
    rest = problem.track_residuals(linear.positions)
    rms = _root_mean_square([r.shape for r in rest]), _root_mean_square([r.walk for r in rest])
    check = _check_fit(problem, linear, divergence)
    names = tuple(problem.names)
    fit = DynamicsFit(
        names, z, spread, rms, problem.noise, evaluations_before + 1, problem.step_widths, check
    )
    return fit, linear


def _check_fit(problem: Problem, linear: Linearisation, divergence: Sequence[Residual]) -> ModelCheck:
    differences = [r.shape for r in divergence]
    return check_model(problem.recordings, linear.positions, differences, config=problem.config)


def _root_mean_square(values: Sequence[FloatArray]) -> float:
    """Root mean square of the residuals that exist, 0 if none does; 0 stands for a frame or second without
    one."""
    every = np.concatenate([v[v != 0] for v in values])
    return float(np.sqrt(np.mean(every**2))) if len(every) else 0.0


def _step_widths(linear: Linearisation, config: IdentificationConfig) -> FloatArray:
    """Steps of z that move the markers by `step_motion`, within limits, shape (P,)."""
    squares = np.array([(s**2).mean(axis=(1, 2, 3)) for s in linear.tangents])
    return np.clip(config.step_motion / np.sqrt(squares.mean(axis=0) + 1e-30), *config.step_widths)


def _estimate_noise(problem: Problem, linear: Linearisation) -> tuple[float, float]:
    """Noise of shape and walk [m]: the residuals, and the divergence of the robot and of its prediction."""
    residuals = problem.track_residuals(linear.positions)
    times, memory = problem.recordings[0].tracked.times, problem.config.correlation_time
    rate = (len(times) - 1) / (times[-1] - times[0])
    divergence = [compute_residual(r, x) for r, x in zip(problem.recordings, linear.divergence, strict=True)]
    least = problem.config.camera_noise / 3
    return (
        max(
            least,
            correlated_noise(
                [r.shape for r in residuals], [r.shape for r in divergence], round(memory * rate)
            ),
        ),
        max(
            least, correlated_noise([r.walk for r in residuals], [r.walk for r in divergence], round(memory))
        ),
    )


def correlated_noise(residuals: Sequence[FloatArray], divergence: Sequence[FloatArray], memory: int) -> float:
    """Root mean square, enlarged where neighbours in time are correlated: fewer values are independent."""
    squares = [_root_mean_square(kind) ** 2 for kind in (residuals, divergence)]
    correlation = 1.0
    total = sum(float((v**2).sum()) for v in residuals)
    for lag in range(1, memory + 1) if total else ():
        product = sum(float((v[lag:] * v[:-lag]).sum()) for v in residuals)
        correlation += 2 * (1 - lag / (memory + 1)) * product / total
    return float(np.sqrt(squares[0] * max(correlation, 1.0) + squares[1]))
