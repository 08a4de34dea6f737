"""Parameters of a spring from one recorded heating and cooling: least squares on its temperature.

The heat model of `eldir.built.heat` is driven by the measured current. The fit finds the parameters that
bring its temperature nearest to the measured one, with 95 % confidence intervals from the curvature of the
sum of squares, widened where neighbouring residuals err together. Samples that are faults of a sensor are
found with a robust loss, named, and left out. Constants that the recording does not determine, such as the
latent heat of a spring that was never hot enough, stay unchanged.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

from eldir.core.records import BoolArray, FloatArray
from eldir.errors import InputError
from eldir.parameters.springs import SpringParameters
from eldir_calibration.springs.model import SpringModel
from eldir_calibration.springs.recording import (
    SensorFault,
    SpringRecording,
    estimate_noise,
    find_jumps,
    find_outliers,
    find_stuck_samples,
    group_faults,
    require_few_faults,
)

_logger = logging.getLogger(__name__)

_MAX_EVALUATIONS = 20  # of the model in one solution
_OUTLIER_ROUNDS = 2  # of leaving samples out
_MAX_MISFIT_RATIO, _MAX_MISFIT_SHARE = 3.0, 0.02
"""The model does not follow a recording if its residual is larger than the noise by this factor and than the
span of the temperatures by this part."""
_MAX_NOISE_RATIO = 1.5  # a larger ratio of residual and noise gives a remark
_PRIOR_AMBIENT = 3.0  # how much the surroundings change from knot to knot, as a standard deviation [K]
_MAX_LAG = 200  # samples over which residuals may err together
_CONVECTION = {"loss_still": "convection_still", "loss_fan": "convection_fan"}


@dataclass(frozen=True)
class ParameterEstimate:
    """A value and half the width of its 95 % confidence interval."""

    value: float
    margin: float

    def __str__(self) -> str:
        return f"{self.value:.4g} +- {self.margin:.2g}"


@dataclass(frozen=True)
class SpringFit:
    """Fitted parameters of a spring."""

    parameters: SpringParameters
    """All parameters: the fitted ones, and the former ones where nothing was fitted."""
    estimates: dict[str, ParameterEstimate]
    """Estimates by their name in `SpringParameters`;
    also heat_capacity_times_mass [J/K], loss_still, loss_fan [W/K]."""
    residual: float
    """Root of the mean square between measured and modelled temperature [K], without the faults."""
    unidentified: tuple[str, ...]
    """Names of the parameters that the recording does not determine."""
    noise: float
    """Standard deviation of the noise from sample to sample [K]."""
    faults: tuple[SensorFault, ...]
    """Samples that were left out."""
    ambient_range: tuple[float, float]
    """Temperature of the surroundings at the start and at the end [C]."""

    @property
    def remarks(self) -> list[str]:
        """Remarks on the quality, one sentence each."""
        remarks = []
        if (ratio := self.residual / self.noise) > _MAX_NOISE_RATIO:
            remarks.append(
                f"the residual is {ratio:.1f} times the noise of {self.noise:.2g} K: the model lacks an "
                "effect, such as the lag of the thermocouple; the intervals are wider for it"
            )
        before, after = self.ambient_range
        if abs(after - before) > 1.0:
            remarks.append(f"the surroundings went from {before:.1f} to {after:.1f} C; ambient is their mean")
        return remarks + [f"left out as a fault of a sensor: {fault}" for fault in self.faults]


def fit_spring(recording: SpringRecording, former: SpringParameters) -> SpringFit:
    """Fit the parameters; `former` gives the geometry, first guesses, and values that cannot be fitted.

    Raises `InputError` where too many samples are faults, where the model does not explain the recording, and
    where it does not determine a parameter.
    """
    recording, faults = _repair_jumps(recording)
    resistance = _fit_resistance(recording)
    ambient = float(np.median(recording.temperature[:3]))
    former = replace(former.with_resistance(resistance.value), ambient=ambient)
    model = SpringModel(recording, former, ambient)
    names, unidentified = model.identifiable()
    noise = estimate_noise(recording.temperature)
    solution = _solve(model, names, recording, noise)
    _logger.info(
        "fitted the parameters %s to %d samples, of which %d are no outliers",
        ", ".join(names) or "nothing",
        len(recording.time),
        solution.good.sum(),
    )
    faults += group_faults("temperature", ~solution.good, recording.time, recording.temperature)
    require_few_faults(faults, len(recording.time))
    _require_explained(solution, recording, noise)
    found = dict(zip(names, solution.x.tolist(), strict=True))
    _require_within_bounds(found, model)
    estimates = _estimate_parameters(model, names, solution, former)
    estimates["resistance"] = resistance
    parameters = model.parameters(found)
    if recording.length is not None and "latent_heat" in names:
        lengths, bad = _fit_lengths(model, names, solution, recording.length)
        faults += group_faults("length", bad, recording.time, 1e3 * recording.length)
        estimates |= lengths
        parameters = replace(
            parameters,
            cold_length=estimates["cold_length"].value,
            hot_length=estimates["hot_length"].value,
        )
    around = model.surroundings(model.guess | found)
    return SpringFit(
        parameters,
        estimates,
        float(np.sqrt(np.mean(solution.residuals[solution.good] ** 2))),
        unidentified,
        noise,
        tuple(faults),
        (float(around[0]), float(around[-1])),
    )


@dataclass(frozen=True)
class _Solution:
    x: FloatArray
    residuals: FloatArray
    """Residual of every sample [K], shape (N,)."""
    good: BoolArray
    """Samples that were used, shape (N,)."""
    covariance: FloatArray
    freedom: int


def _solve(model: SpringModel, names: list[str], recording: SpringRecording, noise: float) -> _Solution:
    """The unknowns with a robust loss, then by least squares without the samples that are faults."""
    low, high = (np.array([model.bounds[n][k] for n in names]) for k in (0, 1))
    scale = np.array([max(abs(model.guess[n]), 1.0) if "_" in n else 1.0 for n in names])
    stuck = find_stuck_samples(recording.temperature)
    prior = _prior(model, names) * noise / _PRIOR_AMBIENT

    def usable(x: FloatArray) -> BoolArray:
        modelled = recording.temperature + model.residuals(names, x)
        return ~stuck & ~find_outliers(modelled, recording.temperature, noise)

    def solve(start: FloatArray, good: BoolArray, loss: Literal["linear", "cauchy"]) -> Any:
        return least_squares(
            lambda x: np.concatenate([model.residuals(names, x)[good], prior @ x]),
            start,
            jac=lambda x: np.concatenate([model.jacobian(names, x)[good], prior]),
            bounds=(low, high),
            x_scale=scale,
            loss=loss,
            f_scale=3.0 * noise,
            max_nfev=_MAX_EVALUATIONS,
        )

    x = solve(np.array([model.guess[n] for n in names]), ~stuck, "cauchy").x
    good = usable(x)
    for _ in range(_OUTLIER_ROUNDS):
        solved = solve(x, good, "linear")
        x, before = solved.x, good
        good = usable(x)
        if (good == before).all():
            break
    residuals = model.residuals(names, x)
    jacobian = np.concatenate([model.jacobian(names, x)[before], prior])
    freedom = max(int(before.sum()) - len(names), 1)
    residuals_used = residuals[before]
    variance = float(residuals_used @ residuals_used) / freedom * _correlation_factor(residuals_used)
    return _Solution(x, residuals, before, variance * np.linalg.pinv(jacobian.T @ jacobian), freedom)


def _prior(model: SpringModel, names: list[str]) -> FloatArray:
    """Differences between neighbouring knots of the surroundings' temperature, shape (K - 1, P)."""
    knots = [n for n in model.knots if n in names]
    rows = np.zeros((max(len(knots) - 1, 0), len(names)))
    for row, a, b in zip(rows, knots, knots[1:], strict=False):
        row[names.index(a)], row[names.index(b)] = -1.0, 1.0
    return rows


def _correlation_factor(residuals: FloatArray) -> float:
    """By which factor neighbouring residuals that err together raise the variance of a mean: one and twice
    the sum of their correlations, up to the first that is not larger than chance."""
    r = residuals - residuals.mean()
    n, total = len(r), float(r @ r)
    factor = 1.0
    for lag in range(1, min(_MAX_LAG, n // 4)):
        correlation = float(r[:-lag] @ r[lag:]) / total
        if correlation < 2.0 / np.sqrt(n):
            break
        factor += 2.0 * correlation
    return factor


def _estimate_parameters(
    model: SpringModel, names: list[str], solution: _Solution, former: SpringParameters
) -> dict[str, ParameterEstimate]:
    """What is reported: the unknowns themselves, and what follows from them."""

    def estimate(weights: FloatArray) -> ParameterEstimate:
        variance = float(weights @ solution.covariance @ weights)
        margin = float(stdtrit(solution.freedom, 0.975)) * np.sqrt(max(variance, 0.0))
        return ParameterEstimate(float(weights @ solution.x), float(margin))

    unit = dict(zip(names, np.eye(len(names)), strict=True))
    hidden = ("ambient", "switch", "austenite_width", "martensite_width")
    found = {n: estimate(unit[n]) for n in names if not n.startswith(hidden)}
    for phase, sign in (("austenite", 1.0), ("martensite", -1.0)):
        if {f"{phase}_start", f"{phase}_width"} <= set(names):
            found[f"{phase}_finish"] = estimate(unit[f"{phase}_start"] + sign * unit[f"{phase}_width"])
    for loss, convection in _CONVECTION.items():
        if loss in names:
            found[convection] = estimate(unit[loss] / model.area)
    found["heat_capacity_times_mass"] = estimate(unit["heat_capacity"] * former.mass)
    mean = estimate(model.mean_ambient_weights(names))
    found["ambient"] = replace(mean, value=mean.value + model.mean_measured_ambient)
    return found


def _require_explained(solution: _Solution, recording: SpringRecording, noise: float) -> None:
    residuals_used = solution.residuals[solution.good]
    rms = float(np.sqrt(np.mean(residuals_used**2)))
    if rms > _MAX_MISFIT_RATIO * noise and rms > _MAX_MISFIT_SHARE * float(
        np.ptp(recording.temperature[solution.good])
    ):
        worst = float(recording.time[solution.good][np.abs(residuals_used).argmax()])
        raise InputError(
            "the heat model does not explain the recording",
            code="spring.model-misfit",
            expected=f"a residual near its noise, {noise:.2g} K",
            found=f"{rms:.2g} K, most at {worst:g} s",
            remedy="use a thin thermocouple in good contact, and the current of this spring alone",
        )


def _require_within_bounds(found: dict[str, float], model: SpringModel) -> None:
    for name, value in found.items():
        low, high = model.bounds[name]
        if not name.startswith("switch") and min(value - low, high - value) < 1e-3 * (high - low):
            raise InputError(
                f"the recording does not determine {name}",
                code="spring.undetermined",
                expected=f"a value between {low:.4g} and {high:.4g}",
                found=f"{value:.4g}, at the edge",
                remedy="heat above the austenite finish, cool below the martensite finish; check the columns",
            )


def _repair_jumps(recording: SpringRecording) -> tuple[SpringRecording, list[SensorFault]]:
    """The recording with single wrong samples of the current replaced by the mean of their neighbours."""
    jumps = find_jumps(recording.current)
    faults = group_faults("current", jumps, recording.time, recording.current)
    current = recording.current.copy()
    current[jumps] = np.interp(recording.time[jumps], recording.time[~jumps], current[~jumps])
    return replace(recording, current=current), faults


def _fit_resistance(recording: SpringRecording) -> ParameterEstimate:
    """Median of U / I while it is heated [Ohm]."""
    values = recording.voltage[recording.heated] / recording.current[recording.heated]
    median = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(values - median)))
    margin = 1.2533 * spread / np.sqrt(len(values)) if len(values) > 2 else np.inf
    return ParameterEstimate(median, float(stdtrit(max(len(values) - 1, 1), 0.975) * margin))


def _fit_lengths(
    model: SpringModel, names: list[str], solution: _Solution, length: FloatArray
) -> tuple[dict[str, ParameterEstimate], BoolArray]:
    """Cold and hot length by a straight line over the martensite fraction, and samples that are not on it.
    Their errors hold those of the fraction."""
    fraction, perturbed, steps = model.martensite_fractions(names, solution.x)
    basis = np.stack([fraction, 1.0 - fraction], axis=1)
    good = ~find_stuck_samples(length)
    for _ in range(_OUTLIER_ROUNDS):
        line, *_ = np.linalg.lstsq(basis[good], length[good], rcond=None)
        good = good & ~find_outliers(basis @ line, length, estimate_noise(length))
    inverse = np.linalg.pinv(basis[good])
    line = inverse @ length[good]
    residuals_used = length[good] - basis[good] @ line
    freedom = len(residuals_used) - 2
    scatter = (
        float(residuals_used @ residuals_used)
        / freedom
        * _correlation_factor(residuals_used)
        * (inverse @ inverse.T)
    )
    sensitivities = inverse @ ((fraction[:, None] - perturbed)[good] * (line[0] - line[1])) / steps
    deviation = np.sqrt(np.diag(scatter + sensitivities @ solution.covariance @ sensitivities.T))
    margins = stdtrit(freedom, 0.975) * deviation
    pairs = zip(("cold_length", "hot_length"), line.tolist(), margins.tolist(), strict=True)
    return {name: ParameterEstimate(v, m) for name, v, m in pairs}, ~good
