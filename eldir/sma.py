"""Two-way shape-memory springs heated by a current: heat balance, hysteresis, free length.

    m c dT/dt = I^2 R(xi) - h A (T - T_ambient) + m L dxi/dt

with xi the martensite fraction, which falls while heating (L > 0 is then absorbed). The kinetics are
Liang and Rogers' cosines. Written for a change from T to T' they need no memory of the turning point,
and minor loops start by themselves from the fraction at which the temperature turned:

    heating   xi' = xi gA(T')/gA(T)                      gA = [cos(pi (T - As)/(Af - As)) + 1]/2
    cooling   1 - xi' = (1 - xi) (1 - gM(T'))/(1 - gM(T))   gM = [cos(pi (T - Mf)/(Ms - Mf)) + 1]/2
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from eldir.errors import InputError
from eldir.frozen import BoolArray, FloatArray, Record

_SECANTS = 4  # rounds for the heat capacity over a step; a fifth changes T by less than 1e-3 K
_LARGEST_CHANGE = 2.0  # steps are divided so that no temperature changes by more in one part [K]
_SPREAD = {
    "heat_capacity": 0.03,
    "convection_fan": 0.04,
    "convection_still": 0.04,
    "latent_heat": 0.05,
}


@dataclass(frozen=True)
class SpringParameters:
    """One spring on its supply; defaults are the built robot's, assumed until measured."""

    wire_diameter: float = 0.75e-3
    """[m]"""
    coil_diameter: float = 6.5e-3
    """Mean diameter of the coil [m]."""
    turns: float = 26.7
    density: float = 6450.0
    """[kg/m3]"""
    heat_capacity: float = 466.0
    """[J/(kg K)]"""
    latent_heat: float = 12_200.0
    """[J/kg]"""
    resistivity_martensite: float = 0.8e-6
    """[Ohm m]"""
    resistivity_austenite: float = 0.8e-6
    """[Ohm m]"""
    supply_voltage: float = 11.0
    """[V]"""
    current_limit: float = 4.0
    """Of the supply output that feeds this spring [A]."""
    lead_resistance: float = 0.05
    """[Ohm]"""
    convection_fan: float = 150.0
    """[W/(m2 K)]"""
    convection_still: float = 50.0
    """[W/(m2 K)]"""
    fan: bool = True
    """Whether the fan blows."""
    ambient: float = 22.0
    """[C]"""
    austenite_start: float = 45.0
    """As [C]; the paper does not give it."""
    austenite_finish: float = 60.0
    """Af [C]"""
    martensite_start: float = 45.0
    """Ms [C]; the paper does not give it."""
    martensite_finish: float = 30.0
    """Mf [C]"""
    cold_length: float = 0.035
    """Free length between centres, all martensite [m]."""
    hot_length: float = 0.075
    """Free length between centres, all austenite [m]."""
    shear_modulus_cold: float = 9e9
    """[Pa]"""
    shear_modulus_hot: float = 23e9
    """[Pa]"""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name == "fan":
                continue
            least = -273.15 if name in _TEMPERATURES else 0.0
            if not (np.isfinite(value) and (value > least or (value == 0 and name in _MAY_BE_ZERO))):
                raise InputError(
                    f"SpringParameters.{name} is wrong", expected=f"more than {least:g}", found=repr(value)
                )
        for low, high in (
            ("austenite_start", "austenite_finish"),
            ("martensite_finish", "martensite_start"),
        ):
            if not getattr(self, low) < getattr(self, high):
                raise InputError(
                    f"SpringParameters.{low} must lie below {high}",
                    expected=f"less than {getattr(self, high):g} C",
                    found=f"{getattr(self, low):g} C",
                )

    @cached_property
    def wire_length(self) -> float:
        """[m]"""
        return float(np.pi * self.coil_diameter * self.turns)

    @cached_property
    def mass(self) -> float:
        """[kg]"""
        return float(self.density * self._section * self.wire_length)

    @cached_property
    def resistance(self) -> float:
        """Of the martensite [Ohm]."""
        return self.resistivity_martensite * self.wire_length / self._section

    @property
    def loss(self) -> float:
        """Heat lost for each kelvin above ambient, h A [W/K]."""
        convection = self.convection_fan if self.fan else self.convection_still
        return float(convection * np.pi * self.wire_diameter * self.wire_length)

    @property
    def _section(self) -> float:
        return float(np.pi / 4 * self.wire_diameter**2)

    def resistance_at(self, martensite: FloatArray | float) -> Any:
        """R(xi), linear between the phases [Ohm]."""
        mixed = self.resistivity_austenite + martensite * (
            self.resistivity_martensite - self.resistivity_austenite
        )
        return mixed * self.wire_length / self._section

    def current(self, martensite: FloatArray | float = 0.0) -> Any:
        """Through the closed contact: the supply holds its voltage up to its current limit [A]."""
        free = self.supply_voltage / (self.resistance_at(martensite) + self.lead_resistance)
        return np.minimum(self.current_limit, free)

    def power(self, martensite: FloatArray | float = 0.0) -> Any:
        """Heat in the spring while its contact is closed [W]."""
        return self.current(martensite) ** 2 * self.resistance_at(martensite)

    @property
    def steady_temperature(self) -> float:
        """Where a spring held on for ever settles [C]; with two phases, the hotter of both."""
        return self.ambient + max(float(self.power(0.0)), float(self.power(1.0))) / self.loss

    def length(self, martensite: FloatArray | float) -> Any:
        """Free length between centres [m]."""
        return self.cold_length + (self.hot_length - self.cold_length) * (1.0 - martensite)

    def stiffness(self, martensite: FloatArray | float) -> Any:
        """G d^4 / (8 D^3 n), the modulus mixed by fraction [N/m]."""
        modulus = self.shear_modulus_hot + martensite * (self.shear_modulus_cold - self.shear_modulus_hot)
        return modulus * self.wire_diameter**4 / (8 * self.coil_diameter**3 * self.turns)

    def with_resistance(self, ohm: float) -> SpringParameters:
        """The same spring with the resistance measured at room temperature [Ohm]."""
        scale = ohm / self.resistance
        return replace(
            self,
            resistivity_martensite=self.resistivity_martensite * scale,
            resistivity_austenite=self.resistivity_austenite * scale,
        )

    def perturbed(self, rng: np.random.Generator) -> SpringParameters:
        """Another specimen, off by no more than two standard deviations: constants and resistance by 2 to
        5 per cent, lengths by 1 mm, transition temperatures together by 1 K."""

        def normal() -> float:
            return float(np.clip(rng.standard_normal(), -2.0, 2.0))

        values = {n: getattr(self, n) * (1.0 + sigma * normal()) for n, sigma in _SPREAD.items()}
        shift = normal()
        values |= {n: getattr(self, n) + shift for n in sorted(_TEMPERATURES - {"ambient"})}
        values |= {n: getattr(self, n) + 1e-3 * normal() for n in ("cold_length", "hot_length")}
        specimen = replace(self, **values)
        return specimen.with_resistance(self.resistance * (1.0 + 0.02 * normal()))


_TEMPERATURES = {"ambient", "austenite_start", "austenite_finish", "martensite_start", "martensite_finish"}
_MAY_BE_ZERO = {"latent_heat", "lead_resistance"}


@dataclass(frozen=True, eq=False)
class SpringState(Record):
    """Where A springs stand."""

    temperature: FloatArray
    """[C], shape (A,)."""
    martensite: FloatArray
    """Fraction xi, shape (A,)."""

    def __post_init__(self) -> None:
        self._set_array("temperature", np.float64, (None,))
        self._set_array("martensite", np.float64, (len(self.temperature),))

    @classmethod
    def cold(cls, count: int, parameters: SpringParameters | None = None) -> SpringState:
        """`count` springs at ambient temperature, all martensite."""
        ambient = (parameters or SpringParameters()).ambient
        return cls(np.full(count, ambient), np.ones(count))


@dataclass(frozen=True, eq=False)
class SpringHistory(Record):
    """A springs at the end of each of T steps."""

    temperature: FloatArray
    """[C], shape (T, A)."""
    martensite: FloatArray
    """Fraction xi, shape (T, A)."""
    length: FloatArray
    """Free length between centres [m], shape (T, A)."""
    current: FloatArray
    """Mean over the step [A], shape (T, A)."""

    @property
    def final(self) -> SpringState:
        """To go on from."""
        return SpringState(self.temperature[-1], self.martensite[-1])


class _Kinetics:
    """The two cosines of A springs, evaluated together."""

    def __init__(self, parameters: Sequence[SpringParameters]):
        self._low = np.array(
            [[p.austenite_start for p in parameters], [p.martensite_finish for p in parameters]]
        )
        high = np.array([[p.austenite_finish for p in parameters], [p.martensite_start for p in parameters]])
        self._scale = np.pi / (high - self._low)

    def cosines(self, temperature: FloatArray) -> FloatArray:
        """gA, the martensite left by heating, and 1 - gM, the austenite left by cooling, shape (2, A)."""
        angle = np.minimum(np.maximum((temperature - self._low) * self._scale, 0.0), np.pi)
        cosine = np.cos(angle)
        cosine[1] *= -1.0
        return (cosine + 1.0) / 2.0

    def fraction(
        self, xi: FloatArray, before: FloatArray, heating: BoolArray, after: FloatArray
    ) -> FloatArray:
        """The martensite after a monotone change to temperature `after`, from cosines `before`."""
        ratio = np.divide(self.cosines(after), before, out=np.zeros_like(before), where=before > 0)
        np.minimum(ratio, 1.0, out=ratio)
        return np.where(heating, xi * ratio[0], 1.0 - (1.0 - xi) * ratio[1])


class HeatModel:
    """A springs with parameters of their own, whose temperatures are followed from state to state."""

    def __init__(self, parameters: Sequence[SpringParameters]):
        def gather(name: str) -> FloatArray:
            return np.array([getattr(p, name) for p in parameters], dtype=np.float64)

        self._kinetics = _Kinetics(parameters)
        self._ambient, self._loss = gather("ambient"), gather("loss")
        self._sensible = gather("mass") * gather("heat_capacity")
        self._latent = gather("mass") * gather("latent_heat")
        self._r_hot = np.array([p.resistance_at(0.0) for p in parameters])
        self._r_change = np.array([p.resistance_at(1.0) for p in parameters]) - self._r_hot
        self._lead, self._voltage = gather("lead_resistance"), gather("supply_voltage")
        self._most = gather("current_limit")
        self._cold, self._hot = gather("cold_length"), gather("hot_length")
        least, greatest = (f(self._r_hot, self._r_hot + self._r_change) for f in (np.minimum, np.maximum))
        self._strongest = np.minimum(self._most, self._voltage / least) ** 2 * greatest

    def run(self, on: BoolArray | FloatArray, dt: float, state: SpringState | None = None) -> SpringHistory:
        """Temperatures, fractions and lengths while contacts switch; see `heat`."""
        on = np.asarray(on, dtype=np.float64)
        loss, sensible, fraction = self._loss, self._sensible, self._kinetics.fraction
        temperature = self._ambient.copy() if state is None else state.temperature.copy()
        xi = np.ones(len(loss)) if state is None else state.martensite.copy()
        heated = on.max(axis=0, initial=0.0) * self._strongest
        strongest = np.maximum(heated, loss * np.abs(temperature - self._ambient))
        parts = max(1, int(np.ceil((strongest / sensible).max(initial=0.0) * dt / _LARGEST_CHANGE)))
        temperatures, fractions, currents = (np.empty(on.shape) for _ in range(3))
        for t, closed in enumerate(on):
            charge = np.zeros(len(loss))
            for _ in range(parts):
                resistance = self._r_hot + self._r_change * xi
                current = np.minimum(self._most, self._voltage / (resistance + self._lead))
                target = self._ambient + closed * current**2 * resistance / loss
                heating, cosines = target > temperature, self._kinetics.cosines(temperature)
                capacity = sensible
                for _ in range(_SECANTS):
                    after = target + (temperature - target) * np.exp(-loss * dt / parts / capacity)
                    xi_after = fraction(xi, cosines, heating, after)
                    if not (changed := xi_after != xi).any():
                        break
                    rise = after - temperature
                    secant = np.divide(xi_after - xi, rise, out=np.zeros_like(xi), where=changed)
                    capacity = sensible - self._latent * secant
                temperature, xi = after, xi_after
                charge += closed * current / parts
            temperatures[t], fractions[t], currents[t] = temperature, xi, charge
        lengths = self._cold + (self._hot - self._cold) * (1.0 - fractions)
        return SpringHistory(temperatures, fractions, lengths, currents)


def heat(
    on: BoolArray | FloatArray,
    dt: float,
    parameters: SpringParameters | Sequence[SpringParameters],
    state: SpringState | None = None,
) -> SpringHistory:
    """Temperatures, fractions and lengths of A springs while their contacts switch.

    `on` (T, A): whether the contact is closed in each step of `dt` seconds, or which part of it.
    One set of parameters serves all springs, or each has its own. Without `state` the springs start cold.

    Each step is the exact exponential for a heat capacity that is the secant of the transformation
    over it, so that heat in, heat lost and heat stored balance; long steps are divided.
    """
    on = np.asarray(on, dtype=np.float64)
    if on.ndim != 2:
        raise InputError("heat: `on` has the wrong shape", expected="(steps, springs)", found=str(on.shape))
    each = [parameters] * on.shape[1] if isinstance(parameters, SpringParameters) else list(parameters)
    if len(each) != on.shape[1]:
        raise InputError(
            "heat: parameters do not fit the springs", expected=str(on.shape[1]), found=str(len(each))
        )
    return HeatModel(each).run(on, dt, state)


def time_to(temperature: float, parameters: SpringParameters, limit: float = 600.0) -> float:
    """How long a cold spring held on needs to reach `temperature` [s]; inf where it never does."""
    dt = 0.01
    history = heat(np.ones((1, 1)), dt, parameters)
    elapsed = dt
    while history.temperature[-1, 0] < temperature:
        if elapsed >= limit:
            return float("inf")
        history = heat(np.ones((100, 1)), dt, parameters, history.final)
        reached = np.flatnonzero(history.temperature[:, 0] >= temperature)
        elapsed += dt * (reached[0] + 1 if len(reached) else 100)
        if len(reached):
            break
    return elapsed
