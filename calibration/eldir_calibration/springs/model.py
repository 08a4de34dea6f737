"""The heat model driven by a recording: its temperatures for many parameters at once."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from eldir.built.heat import HeatModel, SpringState
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters
from eldir_calibration.springs.recording import SpringRecording

_STEP = 0.2  # of the model [s]
_AMBIENT_STEPS = 25  # the temperature of the surroundings changes in stairs of so many steps
_HIGH_VOLTAGE = 1e6  # of a supply that always gives its current [V]
_PERTURBATION = 1e-3  # for derivatives, relative, in kelvin or in seconds
_MIN_SENSITIVITY = (
    0.02  # a parameter is not identifiable where 0.1 % of it changes no temperature by more [K]
)
_KNOT_INTERVAL = 60.0  # [s]
_MAX_KNOTS = 6
_MAX_SWITCHES = 12

Bounds = tuple[float, float]


class SpringModel:
    """The recording on the model's grid. Its unknowns are named; `guess` has their first values.

    Besides the spring's parameters they are the temperature of the surroundings at the knots of a line
    (`ambient_0`, ... [C]; with a measured one, its offset), and the instants at which the current was
    switched (`switch_0`, ... [s]), which lie somewhere between two samples.
    """

    def __init__(self, recording: SpringRecording, former: SpringParameters, ambient: float):
        """`ambient`: first guess of the temperature of the surroundings [C]."""
        self._recording, self._former = recording, former
        time, current = recording.time, recording.current
        steps = int(np.ceil((time[-1] - time[0]) / _STEP))
        self._grid = time[0] + _STEP * np.arange(steps + 1)
        self._midpoints = (time[1:] + time[:-1]) / 2
        middle = self._grid[:-1] + _STEP / 2
        self._fan = recording.fan[np.searchsorted(self._midpoints, middle)]
        self._max_current = float(current.max())
        self._segments = self._constant_segments()
        self.area = np.pi * former.wire_diameter * former.wire_length
        """Surface of the wire [m2]."""
        self.guess = self._first_guess()
        self.bounds = self._parameter_bounds()
        self._add_ambient(middle, ambient)
        self._add_switches()
        self.guess = {n: float(np.clip(x, *self.bounds[n])) for n, x in self.guess.items()}

    def _first_guess(self) -> dict[str, float]:
        former = self._former
        return {
            "heat_capacity": former.heat_capacity,
            "latent_heat": former.latent_heat,
            "loss_still": former.convection_still * self.area,
            "loss_fan": former.convection_fan * self.area,
            "austenite_start": former.austenite_start,
            "austenite_width": former.austenite_finish - former.austenite_start,
            "martensite_start": former.martensite_start,
            "martensite_width": former.martensite_start - former.martensite_finish,
        }

    def _parameter_bounds(self) -> dict[str, Bounds]:
        return {
            "heat_capacity": (0.3 * self._former.heat_capacity, 4.0 * self._former.heat_capacity),
            "latent_heat": (1.0, 60_000.0),
            "loss_still": (self.area, 300.0 * self.area),
            "loss_fan": (self.area, 1500.0 * self.area),
            "austenite_start": (-10.0, 150.0),
            "austenite_width": (1.0, 80.0),
            "martensite_start": (-10.0, 150.0),
            "martensite_width": (1.0, 80.0),
        }

    def _add_ambient(self, middle: FloatArray, ambient: float) -> None:
        """Add the unknowns of the surroundings' temperature: knots, or the offset of a measured one."""
        time, measured = self._recording.time, self._recording.ambient
        self._measured_ambient = np.zeros(len(middle))
        count = int(np.clip((time[-1] - time[0]) / _KNOT_INTERVAL + 1, 2, _MAX_KNOTS))
        if measured is not None:
            self._measured_ambient, count = np.interp(middle, time, measured), 1
        self.knots = tuple(f"ambient_{i}" for i in range(count))
        knot_times = np.linspace(time[0], time[-1], count)
        self._knot_weights = np.stack(
            [
                np.interp(middle, knot_times, row) if count > 1 else np.ones(len(middle))
                for row in np.eye(count)
            ]
        )
        for knot in self.knots:
            self.guess[knot] = ambient if measured is None else 0.0
            self.bounds[knot] = (self.guess[knot] - 30.0, self.guess[knot] + 30.0)

    def _add_switches(self) -> None:
        """Add the instants at which the current was switched."""
        time = self._recording.time
        edges = np.flatnonzero(np.abs(np.diff(self._recording.current)) > 0.5 * self._max_current)
        self._edges = edges if len(edges) <= _MAX_SWITCHES else edges[:0]
        for i, k in enumerate(self._edges):
            self.guess[f"switch_{i}"] = float(self._midpoints[k])
            self.bounds[f"switch_{i}"] = (float(time[k]), float(time[k + 1]))

    def parameters(self, values: dict[str, float]) -> SpringParameters:
        """The former parameters with these values instead; the surroundings have their mean temperature."""
        v = self.guess | values
        return replace(
            self._former,
            heat_capacity=v["heat_capacity"],
            latent_heat=v["latent_heat"],
            convection_still=v["loss_still"] / self.area,
            convection_fan=v["loss_fan"] / self.area,
            ambient=float(self.surroundings(v).mean()),
            austenite_start=v["austenite_start"],
            austenite_finish=v["austenite_start"] + v["austenite_width"],
            martensite_start=v["martensite_start"],
            martensite_finish=v["martensite_start"] - v["martensite_width"],
        )

    def surroundings(self, values: dict[str, float]) -> FloatArray:
        """Temperature of the surroundings in each step of the model [C], shape (T,)."""
        return self._measured_ambient + np.array([values[k] for k in self.knots]) @ self._knot_weights

    def mean_ambient_weights(self, names: list[str]) -> FloatArray:
        """Weight of each unknown in the mean temperature of the surroundings, shape (P,)."""
        shares = dict(zip(self.knots, self._knot_weights.mean(axis=1).tolist(), strict=True))
        return np.array([shares.get(n, 0.0) for n in names])

    @property
    def mean_measured_ambient(self) -> float:
        """Mean of the measured temperature of the surroundings [C]; 0 where it was not measured."""
        return float(self._measured_ambient.mean())

    def identifiable(self) -> tuple[list[str], tuple[str, ...]]:
        """Names of the unknowns that the recording may determine, and of the parameters that it does not."""
        names = list(self.guess)
        changes = np.abs(self.jacobian(names, np.array(list(self.guess.values()))))
        relative = ("heat_capacity", "latent_heat", "loss_still", "loss_fan")
        scale = np.array([abs(self.guess[n]) if n in relative else 1.0 for n in names])
        sensitive = (changes * scale).max(axis=0) > 10 * _MIN_SENSITIVITY
        return [n for n, s in zip(names, sensitive, strict=True) if s], tuple(
            n
            for n, s in zip(names, sensitive, strict=True)
            if not s and not n.startswith(("ambient", "switch"))
        )

    def residuals(self, names: list[str], x: FloatArray) -> FloatArray:
        """Modelled less measured temperature at each sample [K], shape (N,)."""
        return self._model(tuple(names), tuple(x))[0] - self._recording.temperature

    def jacobian(self, names: list[str], x: FloatArray) -> FloatArray:
        """Derivatives of the residuals, shape (N, P); all perturbed springs run in one run of the model."""
        base, perturbed, steps = self._model(tuple(names), tuple(x))
        return (perturbed - base[:, None]) / steps

    def martensite_fractions(
        self, names: list[str], x: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Martensite fraction at the samples (N,), with each unknown perturbed (N, P), and the perturbations
        (P,)."""
        variants, steps = self._perturb(tuple(names), tuple(x))
        _, fraction = self._simulate(variants)
        return fraction[:, 0], fraction[:, 1:], steps

    @lru_cache(maxsize=4)  # noqa: B019  the solver asks for residuals and derivatives at the same point
    def _model(
        self, names: tuple[str, ...], x: tuple[float, ...]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        variants, steps = self._perturb(names, x)
        temperature, _ = self._simulate(variants)
        return temperature[:, 0], temperature[:, 1:], steps

    def _perturb(
        self, names: tuple[str, ...], x: tuple[float, ...]
    ) -> tuple[list[dict[str, float]], FloatArray]:
        """The values, then the values with one unknown after the other perturbed; and the perturbations
        (P,)."""
        values = self.guess | dict(zip(names, x, strict=True))
        absolute = ("ambient", "switch", "austenite", "martensite")
        steps = np.array(
            [_PERTURBATION if n.startswith(absolute) else _PERTURBATION * abs(values[n]) for n in names]
        )
        return [values, *(values | {n: values[n] + h} for n, h in zip(names, steps, strict=True))], steps

    def _simulate(self, variants: list[dict[str, float]]) -> tuple[FloatArray, FloatArray]:
        """Temperatures and fractions at the samples, shape (N, P) each."""
        springs = [
            replace(
                self.parameters(v),
                current_limit=self._max_current,
                supply_voltage=_HIGH_VOLTAGE,
                lead_resistance=0.0,
            )
            for v in variants
        ]
        on = np.stack([self._heating(v) for v in variants], axis=1)
        ambient = np.stack([self.surroundings(v) for v in variants], axis=1)
        still_air, moving_air = (HeatModel([replace(p, fan=fan) for p in springs]) for fan in (False, True))
        state = SpringState(ambient[0], np.ones(len(springs)))
        temperature, fraction = [state.temperature], [state.martensite]
        for a, b in self._segments:
            model = (moving_air if self._fan[a] else still_air).with_ambient(ambient[a:b].mean(axis=0))
            history = model.run(on[a:b], _STEP, state)
            state = history.final
            temperature += list(history.temperature)
            fraction += list(history.martensite)
        return self._resample(temperature), self._resample(fraction)

    def _heating(self, values: dict[str, float]) -> FloatArray:
        """Part of the strongest heating in each step of the model, shape (T,): the square of the current,
        which changes half-way between samples, or at its switch."""
        time, breaks = self._recording.time, self._midpoints.copy()
        breaks[self._edges] = [values[f"switch_{i}"] for i in range(len(self._edges))]
        nodes = np.concatenate([time[:1], breaks, time[-1:]])
        square = (self._recording.current / self._max_current) ** 2
        energy = np.concatenate([[0.0], np.cumsum(square * np.diff(nodes))])
        return np.clip(np.diff(np.interp(self._grid, nodes, energy)) / _STEP, 0.0, None)

    def _constant_segments(self) -> list[tuple[int, int]]:
        """First and last step of each part in which fan and surroundings stay the same."""
        changes = np.flatnonzero(np.diff(self._fan)) + 1
        cuts = sorted({*changes.tolist(), *range(0, len(self._fan), _AMBIENT_STEPS), len(self._fan)})
        return list(pairwise(cuts))

    def _resample(self, rows: list[FloatArray]) -> FloatArray:
        times = self._recording.time
        return np.stack([np.interp(times, self._grid, column) for column in np.array(rows).T], axis=1)
