"""Parameters of one two-way shape-memory spring and of the supply that heats it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from eldir.core.arguments import require_value
from eldir.core.records import FloatArray, Record, record

_SPREAD = {
    "heat_capacity": 0.03,
    "convection_fan": 0.04,
    "convection_still": 0.04,
    "latent_heat": 0.05,
}
_SHEAR = 0.376
"""Shear modulus over Young's modulus, 1 / 2 (1 + 0.33)."""
_TRANSITIONS = {"austenite_start", "austenite_finish", "martensite_start", "martensite_finish"}
_Celsius = Annotated[float, Field(gt=-273.15)]


@record
class SpringParameters(Record):
    """Parameters of one spring and its supply. The defaults are assumptions for the built robot until it is
    measured."""

    OPTIONAL = frozenset[str]()

    wire_diameter: PositiveFloat = 0.75e-3
    """Diameter of the wire [m]."""
    coil_diameter: PositiveFloat = 6.5e-3
    """Mean diameter of the coil [m]."""
    turns: PositiveFloat = 26.7
    """Number of active turns of the coil."""
    density: PositiveFloat = 6450.0
    """Density of the wire [kg/m3]."""
    heat_capacity: PositiveFloat = 466.0
    """Specific heat capacity of the wire [J/(kg K)]."""
    latent_heat: NonNegativeFloat = 12_200.0
    """Latent heat of the transformation [J/kg]."""
    resistivity_martensite: PositiveFloat = 0.8e-6
    """Resistivity of the wire, all martensite [Ohm m]."""
    resistivity_austenite: PositiveFloat = 0.8e-6
    """Resistivity of the wire, all austenite [Ohm m]."""
    supply_voltage: PositiveFloat = 11.0
    """Voltage of the supply [V]."""
    current_limit: PositiveFloat = 4.0
    """Current limit of the supply output that feeds this spring [A]. The default is that of a robot of which
    no rig is known: its springs then finish their stroke. It is not what a rig may have: that is the rig
    file's `supply.current_limit_a`, which must hold in the worst corner of its tolerances."""
    lead_resistance: NonNegativeFloat = 0.05
    """Resistance of the leads to the spring [Ohm]."""
    convection_fan: PositiveFloat = 150.0
    """Convection coefficient with the fan on [W/(m2 K)]."""
    convection_still: PositiveFloat = 36.0
    """Convection coefficient in still air, radiation included [W/(m2 K)]: that of this wire, straight, at
    60 C (`eldir.parameters.still_air`). A coil loses less."""
    fan: bool = True
    """Whether the fan is on."""
    ambient: _Celsius = 22.0
    """Ambient temperature [C]."""
    austenite_start: _Celsius = 45.0
    """Temperature As at which austenite begins to form [C]; the paper does not give it."""
    austenite_finish: _Celsius = 60.0
    """Temperature Af at which all is austenite [C]."""
    martensite_start: _Celsius = 45.0
    """Temperature Ms at which martensite begins to form [C]; the paper does not give it."""
    martensite_finish: _Celsius = 30.0
    """Temperature Mf at which all is martensite [C]."""
    cold_length: PositiveFloat = 0.035
    """Free length between centres, all martensite [m]."""
    hot_length: PositiveFloat = 0.075
    """Free length between centres, all austenite [m]."""
    ends: NonNegativeFloat = 0.015
    """Part of these lengths that is not coil: the fittings at both ends [m]."""
    shear_modulus_cold: PositiveFloat = 9e9
    """Shear modulus, all martensite [Pa]."""
    shear_modulus_hot: PositiveFloat = 23e9
    """Shear modulus, all austenite [Pa]."""

    def __post_init__(self) -> None:
        for low, high in (
            ("austenite_start", "austenite_finish"),
            ("martensite_finish", "martensite_start"),
        ):
            below, above = getattr(self, low), getattr(self, high)
            require_value(
                f"SpringParameters.{low}", below < above, f"less than {high}, {above:g} C", f"{below:g} C"
            )

    @cached_property
    def wire_length(self) -> float:
        """Length of the wire in the coil [m]."""
        return float(np.pi * self.coil_diameter * self.turns)

    @cached_property
    def mass(self) -> float:
        """Mass of the wire in the coil [kg]."""
        return float(self.density * self._section * self.wire_length)

    @cached_property
    def resistance(self) -> float:
        """Resistance, all martensite [Ohm]."""
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
        """Current through the closed contact [A]: the supply holds its voltage up to its current limit."""
        free = self.supply_voltage / (self.resistance_at(martensite) + self.lead_resistance)
        return np.minimum(self.current_limit, free)

    def power(self, martensite: FloatArray | float = 0.0) -> Any:
        """Heating power in the spring while its contact is closed [W]."""
        return self.current(martensite) ** 2 * self.resistance_at(martensite)

    @property
    def steady_temperature(self) -> float:
        """Temperature at which a spring that stays on settles [C]; the higher one of both phases."""
        return self.ambient + max(float(self.power(0.0)), float(self.power(1.0))) / self.loss

    def length(self, martensite: FloatArray | float) -> Any:
        """Free length between centres [m]."""
        return self.cold_length + (self.hot_length - self.cold_length) * (1.0 - martensite)

    def stiffness(self, martensite: FloatArray | float) -> Any:
        """G d^4 / (8 D^3 n), the modulus mixed by fraction [N/m]."""
        modulus = self.shear_modulus_hot + martensite * (self.shear_modulus_cold - self.shear_modulus_hot)
        return modulus * self.wire_diameter**4 / (8 * self.coil_diameter**3 * self.turns)

    def buckling_shortening(self, length: FloatArray) -> FloatArray:
        """How much a coil of this free length between centres [m] can be compressed until it buckles [m];
        infinite for one that is too short to buckle.

        J. A. Haringx, "On highly compressible helical springs and rubber rods", Philips Research Reports 3
        (1948), for ends that turn freely; the formula of EN 13906-1 with the seating coefficient 1.
        """
        coil = np.maximum(length - self.ends, self.wire_diameter)
        slender = 1.0 - (1.0 - _SHEAR) / (0.5 + _SHEAR) * (np.pi * self.coil_diameter / coil) ** 2
        share = 0.5 / (1.0 - _SHEAR) * (1.0 - np.sqrt(np.maximum(slender, 0.0)))
        return np.where(slender < 0, np.inf, share * coil)

    def with_resistance(self, ohm: float) -> SpringParameters:
        """The same spring with a resistance measured at room temperature [Ohm]."""
        scale = ohm / self.resistance
        return replace(
            self,
            resistivity_martensite=self.resistivity_martensite * scale,
            resistivity_austenite=self.resistivity_austenite * scale,
        )

    @classmethod
    def mean(cls, springs: Sequence[SpringParameters]) -> SpringParameters:
        """The spring whose numbers are the means of these; all with a fan, or all without."""
        names = [f.name for f in fields(cls) if f.name != "fan"]
        values: dict[str, Any] = {n: float(np.mean([getattr(s, n) for s in springs])) for n in names}
        return replace(springs[0], **values)

    def perturbed(self, rng: np.random.Generator) -> SpringParameters:
        """Another spring of the same kind, each number off by at most two standard deviations.

        Standard deviations: 3 to 5 per cent of the thermal constants, 2 per cent of the resistance, 1 mm of
        the lengths, 1 K of all transition temperatures together.
        """

        def normal() -> float:
            return float(np.clip(rng.standard_normal(), -2.0, 2.0))

        values = {n: getattr(self, n) * (1.0 + sigma * normal()) for n, sigma in _SPREAD.items()}
        shift = normal()
        values |= {n: getattr(self, n) + shift for n in sorted(_TRANSITIONS)}
        values |= {n: getattr(self, n) + 1e-3 * normal() for n in ("cold_length", "hot_length")}
        other = replace(self, **values)
        return other.with_resistance(self.resistance * (1.0 + 0.02 * normal()))
