"""Parameters of a spring from one recorded heating and cooling: least squares on its temperature.

The heat model of `eldir.built.heat` is driven by the measured current. The fit finds the parameters that
bring its temperature nearest to the measured one, with 95 % confidence intervals from the curvature of the
sum of squares. Constants that the recording does not determine, such as the latent heat of a spring that
was never hot enough, stay unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from calibration.springs.recording import SpringRecording
from eldir.built.heat import HeatModel, SpringState
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters

_STEP = 0.2  # of the model [s]
_HIGH_VOLTAGE = 1e6  # of a supply that always gives its current [V]
_NUDGE = 1e-3  # for derivatives, relative, or in kelvin
_BLIND = 0.02  # a parameter is not determined where 0.1 % of it moves no temperature by more [K]
_TEMPERATURES = ("austenite_start", "austenite_width", "martensite_start", "martensite_width")
_LOSSES = ("loss_still", "loss_fan")


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
    """Root of the mean square between measured and modelled temperature [K]."""
    left: tuple[str, ...]
    """Names of parameters that the recording does not determine."""


def fit_springs(recording: SpringRecording, former: SpringParameters) -> SpringFit:
    """Fit the parameters; `former` gives the geometry, first guesses, and values that cannot be fitted."""
    resistance = _resistance(recording)
    former = replace(
        former.with_resistance(resistance.value), ambient=float(np.median(recording.temperature[:3]))
    )
    fit = _SpringModel(recording, former)
    names, left = fit.determined()
    start = np.array([fit.guess[n] for n in names])
    lower = np.array([1.0 if n.endswith("width") else 1e-9 for n in names])
    solved = least_squares(
        lambda x: fit.residuals(names, x),
        start,
        jac=lambda x: fit.jacobian(names, x),
        bounds=(lower, np.inf),
        x_scale=np.abs(start),
    )
    freedom = max(len(solved.fun) - len(names), 1)
    variance = float(solved.fun @ solved.fun) / freedom
    covariance = variance * np.linalg.pinv(solved.jac.T @ solved.jac)
    found = dict(zip(names, (float(x) for x in solved.x), strict=True))
    margins = {n: float(m) for n, m in zip(names, _margins(covariance, freedom), strict=True)}
    estimates = {n: ParameterEstimate(found[n], margins[n]) for n in names if not n.endswith("width")}
    for phase, sign in (("austenite", 1.0), ("martensite", -1.0)):
        if f"{phase}_width" in names:
            pick = np.array([1.0 * (n == f"{phase}_start") + sign * (n == f"{phase}_width") for n in names])
            margin = float(_margins((pick @ covariance @ pick)[None, None], freedom)[0])
            estimates[f"{phase}_finish"] = ParameterEstimate(float(pick @ solved.x), margin)
    parameters = fit.parameters(found)
    area = np.pi * former.wire_diameter * former.wire_length
    for name, convection in zip(_LOSSES, ("convection_still", "convection_fan"), strict=True):
        if name in estimates:
            e = estimates[name]
            estimates[convection] = ParameterEstimate(e.value / area, e.margin / area)
    e = estimates["heat_capacity"]
    estimates["heat_capacity_times_mass"] = ParameterEstimate(e.value * former.mass, e.margin * former.mass)
    estimates["resistance"] = resistance
    if recording.length is not None and "latent_heat" in names:
        for name, estimate in fit.lengths(parameters).items():
            estimates[name] = estimate
        parameters = replace(
            parameters,
            cold_length=estimates["cold_length"].value,
            hot_length=estimates["hot_length"].value,
        )
    return SpringFit(parameters, estimates, float(np.sqrt(np.mean(solved.fun**2))), left)


class _SpringModel:
    """The recording on the model's grid, and the model for many parameters at once."""

    def __init__(self, recording: SpringRecording, former: SpringParameters):
        self._recording, self._former = recording, former
        steps = int(np.ceil((recording.time[-1] - recording.time[0]) / _STEP))
        self._grid = recording.time[0] + _STEP * np.arange(1, steps + 1)
        middle = self._grid - _STEP / 2
        at = np.clip(np.searchsorted(recording.time, middle, side="right") - 1, 0, None)
        self._square = recording.current[at] ** 2
        self._fan = recording.fan[at]
        self._peak = float(np.sqrt(self._square.max()))
        area = np.pi * former.wire_diameter * former.wire_length
        self._area = area
        self.guess = {
            "heat_capacity": former.heat_capacity,
            "latent_heat": former.latent_heat,
            "loss_still": former.convection_still * area,
            "loss_fan": former.convection_fan * area,
            "ambient": former.ambient,
            "austenite_start": former.austenite_start,
            "austenite_width": former.austenite_finish - former.austenite_start,
            "martensite_start": former.martensite_start,
            "martensite_width": former.martensite_start - former.martensite_finish,
        }

    def parameters(self, values: dict[str, float]) -> SpringParameters:
        """The former parameters with these values instead."""
        v = self.guess | values
        return replace(
            self._former,
            heat_capacity=v["heat_capacity"],
            latent_heat=v["latent_heat"],
            convection_still=v["loss_still"] / self._area,
            convection_fan=v["loss_fan"] / self._area,
            ambient=v["ambient"],
            austenite_start=v["austenite_start"],
            austenite_finish=v["austenite_start"] + v["austenite_width"],
            martensite_start=v["martensite_start"],
            martensite_finish=v["martensite_start"] - v["martensite_width"],
        )

    def determined(self) -> tuple[list[str], tuple[str, ...]]:
        """Parameters that the recording may determine, and parameters that it does not."""
        names = list(self.guess)
        moved = np.abs(self.jacobian(names, np.array(list(self.guess.values()))))
        scale = np.array([1.0 if n in _TEMPERATURES else abs(self.guess[n]) for n in names])
        seen = (moved * scale).max(axis=0) > 10 * _BLIND
        return [n for n, s in zip(names, seen, strict=True) if s], tuple(
            n for n, s in zip(names, seen, strict=True) if not s
        )

    def residuals(self, names: list[str], x: FloatArray) -> FloatArray:
        """Modelled less measured temperature at each sample [K], shape (N,)."""
        return self._model(tuple(names), tuple(x))[0] - self._recording.temperature

    def jacobian(self, names: list[str], x: FloatArray) -> FloatArray:
        """Derivatives of the residuals, shape (N, P); all perturbed springs run in one run of the model."""
        base, nudged, steps = self._model(tuple(names), tuple(x))
        return (nudged - base[:, None]) / steps

    def lengths(self, parameters: SpringParameters) -> dict[str, ParameterEstimate]:
        """Cold and hot length by a straight line over the martensite fraction."""
        assert self._recording.length is not None
        _, fractions = self._run([parameters])
        basis = np.stack([fractions[:, 0], 1.0 - fractions[:, 0]], axis=1)
        solution, *_ = np.linalg.lstsq(basis, self._recording.length, rcond=None)
        rest = self._recording.length - basis @ solution
        freedom = len(rest) - 2
        covariance = float(rest @ rest) / freedom * np.linalg.inv(basis.T @ basis)
        margins = _margins(covariance, freedom)
        pairs = zip(("cold_length", "hot_length"), solution, margins, strict=True)
        return {name: ParameterEstimate(float(v), float(m)) for name, v, m in pairs}

    @lru_cache(maxsize=4)  # noqa: B019  the solver asks for residuals and derivatives at the same point
    def _model(
        self, names: tuple[str, ...], x: tuple[float, ...]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        values = dict(zip(names, x, strict=True))
        steps = np.array([_NUDGE if n in _TEMPERATURES else _NUDGE * abs(values[n]) for n in names])
        each = [values, *(values | {n: values[n] + h} for n, h in zip(names, steps, strict=True))]
        temperature, _ = self._run([self.parameters(v) for v in each])
        return temperature[:, 0], temperature[:, 1:], steps

    def _run(self, springs: list[SpringParameters]) -> tuple[FloatArray, FloatArray]:
        """Temperatures and fractions at the samples, shape (N, P) each."""
        springs = [
            replace(p, current_limit=self._peak, supply_voltage=_HIGH_VOLTAGE, lead_resistance=0.0)
            for p in springs
        ]
        on = np.repeat((self._square / self._peak**2)[:, None], len(springs), axis=1)
        state = SpringState(np.array([p.ambient for p in springs]), np.ones(len(springs)))
        temperature, fraction = [state.temperature], [state.martensite]
        edges = [0, *(np.flatnonzero(np.diff(self._fan)) + 1), len(self._fan)]
        for a, b in pairwise(edges):
            model = HeatModel([replace(p, fan=bool(self._fan[a])) for p in springs])
            history = model.run(on[a:b], _STEP, state)
            state = history.final
            temperature += list(history.temperature)
            fraction += list(history.martensite)
        grid = np.concatenate([[self._grid[0] - _STEP], self._grid])
        return _sampled(grid, temperature, self._recording.time), _sampled(
            grid, fraction, self._recording.time
        )


def _sampled(grid: FloatArray, rows: list[FloatArray], times: FloatArray) -> FloatArray:
    return np.stack([np.interp(times, grid, column) for column in np.array(rows).T], axis=1)


def _margins(covariance: FloatArray, freedom: int) -> FloatArray:
    return np.asarray(student.ppf(0.975, freedom) * np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _resistance(recording: SpringRecording) -> ParameterEstimate:
    """Mean of U / I while it is heated [Ohm]."""
    values = recording.voltage[recording.heated] / recording.current[recording.heated]
    spread = float(values.std(ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else np.inf
    margin = float(student.ppf(0.975, max(len(values) - 1, 1)) * spread)
    return ParameterEstimate(float(values.mean()), margin)
