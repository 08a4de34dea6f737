"""A second thermal model, written from textbooks, that shares no code with `eldir.built.heat`.

One spring is a lumped piece of wire (its Biot number is below 0.01). Heat: I^2 R while its contact is closed.
Loss: with the fan, a coefficient that the caller gives; in still air free convection of a horizontal cylinder
by Churchill and Chu's laminar form, Nu = 0.36 + 0.518 Ra^(1/4) / [1 + (0.559/Pr)^(9/16)]^(4/9) (Rohsenow,
Hartnett and Cho, Handbook of Heat Transfer), and radiation. Phase: Liang and Rogers' cosines with the
fraction at the last turning point (J. Intell. Mater. Syst. Struct. 1 (1990) 207), the latent heat as a
heat capacity.
Integrated with the classical Runge-Kutta method in fixed steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

STEP = 0.01
SIGMA = 5.670374e-8


@dataclass(frozen=True)
class Wire:
    """A spring and its supply; SI units and degrees Celsius."""

    current: float
    resistance: float
    """Of the whole spring, the same in both phases [Ohm]."""
    ambient: float
    coefficient: Callable[[float], float]
    """Heat transfer coefficient at a surface temperature [W/(m2 K)]."""
    diameter: float = 0.75e-3
    length: float = math.pi * 6.5e-3 * 26.7
    density: float = 6450.0
    heat_capacity: float = 466.0
    latent_heat: float = 12_200.0
    austenite: tuple[float, float] = (45.0, 60.0)
    martensite: tuple[float, float] = (45.0, 30.0)


def still_air(diameter: float, ambient: float, emissivity: float = 0.5) -> Callable[[float], float]:
    """Coefficient of a straight wire in still air, from the surface temperature."""

    def coefficient(surface: float) -> float:
        kelvin = (surface + ambient) / 2 + 273.15
        # Air: Sutherland's viscosity, ideal gas at 1 atm, heat capacity 1007 J/(kg K), Prandtl number 0.706.
        viscosity = 1.458e-6 * kelvin**1.5 / (kelvin + 110.4)
        conductivity = viscosity * 1007.0 / 0.706
        kinematic = viscosity * 287.05 * kelvin / 101_325.0
        rise = max(surface - ambient, 0.01)
        rayleigh = 9.80665 * rise / kelvin * diameter**3 / kinematic**2 * 0.706
        nusselt = 0.36 + 0.518 * rayleigh**0.25 / (1 + (0.559 / 0.706) ** (9 / 16)) ** (4 / 9)
        hot, cold = surface + 273.15, ambient + 273.15
        return nusselt * conductivity / diameter + emissivity * SIGMA * (hot**4 - cold**4) / (
            hot - cold + 1e-9
        )

    return coefficient


class _Phase:
    """The martensite fraction, with the fraction at the last turning point."""

    def __init__(self, wire: Wire):
        self.fraction = self._from = 1.0
        self._warming = True
        self._wire = wire

    def _shape(self, warming: bool, temperature: float) -> tuple[float, float]:
        """The cosine of heating or cooling, 1 to 0 with rising temperature, and its slope [1/K]."""
        low, high = self._wire.austenite if warming else self._wire.martensite[::-1]
        if not low < temperature < high:
            return (1.0 if temperature <= low else 0.0), 0.0
        angle = math.pi * (temperature - low) / (high - low)
        return (math.cos(angle) + 1) / 2, -math.sin(angle) * math.pi / (2 * (high - low))

    def slope(self, warming: bool, temperature: float) -> float:
        """d fraction / d temperature on the branch from the turning point [1/K]."""
        shape, slope = self._shape(warming, temperature)
        start = self.fraction if warming != self._warming else self._from
        if warming:
            return slope * start if start * shape < self.fraction + 1e-9 else 0.0
        return slope * (1 - start) if start + (1 - start) * shape > self.fraction - 1e-9 else 0.0

    def move(self, warming: bool, temperature: float) -> None:
        """Follow the temperature; the fraction never goes back on a branch."""
        if warming != self._warming:
            self._warming, self._from = warming, self.fraction
        shape, _ = self._shape(warming, temperature)
        if warming:
            self.fraction = min(self.fraction, self._from * shape)
        else:
            self.fraction = max(self.fraction, self._from + (1 - self._from) * shape)


def temperatures(wire: Wire, pulses: Sequence[tuple[float, float]], until: float) -> list[float]:
    """Temperature of the wire after each step, heated in each of these spans [s], until a time [s]."""
    surface = math.pi * wire.diameter * wire.length
    mass = wire.density * math.pi / 4 * wire.diameter**2 * wire.length
    phase, temperature, found = _Phase(wire), wire.ambient, []

    def rate(t: float, on: float) -> float:
        flow = on * wire.current**2 * wire.resistance - wire.coefficient(t) * surface * (t - wire.ambient)
        capacity = wire.heat_capacity - wire.latent_heat * phase.slope(flow > 0, t)
        return flow / (mass * capacity)

    for i in range(round(until / STEP)):
        begin = i * STEP
        on = sum(max(0.0, min(b, begin + STEP) - max(a, begin)) for a, b in pulses) / STEP
        k1 = rate(temperature, on)
        k2 = rate(temperature + STEP / 2 * k1, on)
        k3 = rate(temperature + STEP / 2 * k2, on)
        k4 = rate(temperature + STEP * k3, on)
        after = temperature + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        phase.move(after > temperature, after)
        temperature = after
        found.append(temperature)
    return found
