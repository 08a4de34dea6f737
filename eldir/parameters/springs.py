"""Parameters of one two-way shape-memory spring and of the supply that heats it; heat that it loses to air.

Free convection of a long horizontal cylinder: Churchill and Chu, Int. J. Heat Mass Transfer 18 (1975) 1049,
doi 10.1016/0017-9310(75)90222-7, at the mean of surface and air temperature. Air at 1 atm: Incropera and
DeWitt, Fundamentals of Heat and Mass Transfer, table A.4; the same book expects such correlations to be right
within about 20 %. For thin wires published measurements differ more (Morgan, Adv. Heat Transfer 11 (1975)
199).

The turns of a coil lie closer together than the layer of warm air around a thin wire is thick (a few
millimetres). A coil then loses heat like a solid cylinder of its outer diameter (Langmuir, Phys. Rev. 34
(1912) 401: why lamps have coiled filaments), which is less than the wire alone would lose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from eldir.core.arguments import require_value
from eldir.core.records import FloatArray, Record, record
from eldir.parameters.annotations import LargeSpread, Prior, Tolerance, VariesWith, vary

_MODULUS_RATIO = 0.376
"""Shear modulus over Young's modulus, 1 / 2 (1 + 0.33)."""
_FAN_SPEED = 1.42
"""Speed of the air [m/s] in which the kit's wire has its `convection_fan` (`forced_convection`)."""
CORRELATION_ERROR = 0.2
"""Relative error of the correlations for still air."""
EMISSIVITY, MIN_EMISSIVITY = 0.5, 0.2
"""Thermal emissivity of the wire: assumed for its oxide, and, for margins, that of bright metal. The
latter was measured, not on oxidised wire (Javed et al., Int. J. Thermophys. 45, doi
10.1007/s10765-024-03433-0)."""
_STEFAN_BOLTZMANN, _GRAVITY, _ZERO_C = 5.670e-8, 9.81, 273.15
_MAX_TEMPERATURE = 2000.0
"""The steady temperature is not computed beyond this [C]: such a spring is burnt."""
_AIR = np.array(  # temperature [K], conductivity [W/(m K)], kinematic viscosity [m2/s], Prandtl number
    [
        [250.0, 0.0223, 11.44e-6, 0.720],
        [300.0, 0.0263, 15.89e-6, 0.707],
        [350.0, 0.0300, 20.92e-6, 0.700],
        [400.0, 0.0338, 26.41e-6, 0.690],
        [450.0, 0.0373, 32.39e-6, 0.686],
    ]
).T
_SUPPLIER = "suppliers state it within 3 to 5 K; stress raises it by 1 K for each 7 MPa, 3 K in a loaded coil"
_WINDING, _BATCH = "coils are wound and trained by hand", "data sheets, one batch"
_SAMPLED_FIRST = (
    "heat_capacity", "convection_fan", "convection_still", "latent_heat", "austenite_start", "cold_length",
    "hot_length", "resistivity_martensite",
)  # fmt: skip
"""Fields in the order in which former versions sampled them; new fields come after them, by themselves."""
_Celsius = Annotated[float, Field(gt=-273.15)]
_TRANSITION = Tolerance(1.0, "absolute", shared="transition")


SUPPLY = ("supply_voltage", "current_limit", "lead_resistance")
"""Fields of `SpringParameters` that the supply and its leads determine."""


@record
class SpringParameters(Record):
    """Parameters of one spring and its supply. The defaults are assumptions for the built robot until it is
    measured."""

    OPTIONAL = frozenset({"neighbour_conductance"})
    """Keys that files of version 0.1.0 do not have."""

    wire_diameter: PositiveFloat = 0.75e-3
    """Diameter of the wire [m]."""
    coil_diameter: PositiveFloat = 6.5e-3
    """Mean diameter of the coil [m]."""
    turns: PositiveFloat = 26.7
    """Number of active turns of the coil."""
    density: PositiveFloat = 6450.0
    """Density of the wire [kg/m3]."""
    heat_capacity: Annotated[
        PositiveFloat,
        Prior(
            0.03,
            "data sheet; 1.8 % with `--current`, 0.7 % with `--voltage` as well",
            name="heat",
            quantity="heat_capacity",
            unobservable=True,
        ),
        Tolerance(0.03, "relative"),
    ] = 466.0
    """Specific heat capacity of the wire [J/(kg K)]."""
    latent_heat: Annotated[
        NonNegativeFloat,
        Prior(0.05, _BATCH, between_springs=0.05),
        VariesWith("heat"),
        Tolerance(0.05, "relative"),
    ] = 12_200.0
    """Latent heat of the transformation [J/kg]."""
    resistivity_martensite: Annotated[
        PositiveFloat,
        Prior(0.02, "wire length, ohmmeter", name="resistance", quantity="resistivity", unobservable=True),
        Tolerance(0.02, "relative", attribute="resistance"),
    ] = 0.8e-6
    """Resistivity of the wire, all martensite [Ohm m]."""
    resistivity_austenite: Annotated[PositiveFloat, VariesWith("resistance")] = 0.8e-6
    """Resistivity of the wire, all austenite [Ohm m]."""
    supply_voltage: Annotated[
        PositiveFloat, VariesWith("current"), VariesWith("heat", 0.5), VariesWith("resistance", 0.5)
    ] = 11.0
    """Voltage of the supply [V]."""
    current_limit: Annotated[
        PositiveFloat,
        Prior(0.25, "supply setting, contact and lead resistance", name="current", between_springs=0.05),
        VariesWith("heat", 0.5),
        VariesWith("resistance", -0.5),
        LargeSpread(0.1, 0.25),
    ] = 4.0
    """Current limit of the supply output that feeds this spring [A]. The default is that of a robot of which
    no rig is known: its springs then finish their stroke. It is not what a rig may have: that is the rig
    file's `supply.current_limit_a`, which must hold in the worst corner of its tolerances."""
    lead_resistance: Annotated[NonNegativeFloat, VariesWith("resistance")] = 0.05
    """Resistance of the leads to the spring [Ohm]."""
    convection_fan: Annotated[
        PositiveFloat,
        Prior(
            0.35,
            "flow of the fan; published values of h differ by a factor of 2",
            name="cooling",
            between_springs=0.05,
        ),
        VariesWith("heat"),
        Tolerance(0.04, "relative"),
        LargeSpread(0.1, 0.4),
    ] = 150.0
    """Convection coefficient with the fan on [W/(m2 K)]."""
    convection_still: Annotated[
        PositiveFloat, VariesWith("cooling"), VariesWith("heat"), Tolerance(0.04, "relative")
    ] = 36.0
    """Convection coefficient in still air, radiation included [W/(m2 K)]: that of this wire, straight, at
    60 C (`wire_heat_transfer_coefficient`). A coil loses less."""
    fan: bool = True
    """Whether the fan is on."""
    ambient: _Celsius = 22.0
    """Ambient temperature [C]."""
    austenite_start: Annotated[_Celsius, VariesWith("transition"), _TRANSITION] = 45.0
    """Temperature As at which austenite begins to form [C]; the paper does not give it."""
    austenite_finish: Annotated[
        _Celsius, Prior(3.0, _SUPPLIER, name="transition", between_springs=1.0, additive=True), _TRANSITION
    ] = 60.0
    """Temperature Af at which all is austenite [C]."""
    martensite_start: Annotated[_Celsius, VariesWith("transition"), _TRANSITION] = 45.0
    """Temperature Ms at which martensite begins to form [C]; the paper does not give it."""
    martensite_finish: Annotated[_Celsius, VariesWith("transition"), _TRANSITION] = 30.0
    """Temperature Mf at which all is martensite [C]."""
    cold_length: Annotated[
        PositiveFloat,
        Prior(0.2, _WINDING, between_springs=0.05),
        Tolerance(1e-3, "absolute"),
        LargeSpread(0.1, 0.3),
    ] = 0.035
    """Free length between centres, all martensite [m]."""
    hot_length: Annotated[
        PositiveFloat,
        Prior(0.15, _WINDING, between_springs=0.02),
        Tolerance(1e-3, "absolute"),
        LargeSpread(0.1, 0.2),
    ] = 0.075
    """Free length between centres, all austenite [m]."""
    ends: NonNegativeFloat = 0.015
    """Part of these lengths that is not coil: the fittings at both ends [m]."""
    shear_modulus_cold: PositiveFloat = 9e9
    """Shear modulus, all martensite [Pa]."""
    shear_modulus_hot: PositiveFloat = 23e9
    """Shear modulus, all austenite [Pa]."""
    neighbour_conductance: Annotated[float, Field(ge=0, le=1, exclude_if=lambda value: value == 0.0)] = 0.0
    """Heat that passes through a common hub to the spring of another motor, for each kelvin between them
    [W/K]."""

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
        ratio = _MODULUS_RATIO
        root = 1.0 - (1.0 - ratio) / (0.5 + ratio) * (np.pi * self.coil_diameter / coil) ** 2
        compression = 0.5 / (1.0 - ratio) * (1.0 - np.sqrt(np.maximum(root, 0.0)))
        return np.where(root < 0, np.inf, compression * coil)

    def with_resistance(self, ohm: float) -> SpringParameters:
        """The same spring with a resistance measured at room temperature [Ohm]."""
        scale = ohm / self.resistance
        return replace(
            self,
            resistivity_martensite=self.resistivity_martensite * scale,
            resistivity_austenite=self.resistivity_austenite * scale,
        )

    def in_air(self, air_c: float | None) -> SpringParameters:
        """The same spring in air of this temperature [C]; None: in its own."""
        return self if air_c is None else replace(self, ambient=air_c)

    @classmethod
    def mean(cls, springs: Sequence[SpringParameters]) -> SpringParameters:
        """The spring whose numbers are the means of these; all with a fan, or all without."""
        names = [f.name for f in fields(cls) if f.name != "fan"]
        values: dict[str, Any] = {n: float(np.mean([getattr(s, n) for s in springs])) for n in names}
        return replace(springs[0], **values)

    def perturb(
        self, rng: np.random.Generator, max_spreads: Mapping[str, float] | None = None
    ) -> SpringParameters:
        """Another spring of the same batch on the same rig, within the tolerances of its fields.
        `max_spreads`: bounds of their standard deviations. What all springs have in common, and the bounds
        that a rig file gives: `eldir.parameters.tolerances`."""
        values = vary(self, rng, _SAMPLED_FIRST, max_spreads)
        resistance = values.pop("resistance")
        return replace(self, **values).with_resistance(resistance)


def free_convection(diameter: float, surface: float, ambient: float) -> float:
    """Coefficient [W/(m2 K)] of a horizontal cylinder of this diameter [m]; temperatures in C."""
    film = (surface + ambient) / 2 + _ZERO_C
    conductivity, viscosity, prandtl = (float(np.interp(film, _AIR[0], row)) for row in _AIR[1:])
    rayleigh = _GRAVITY / film * abs(surface - ambient) * diameter**3 / viscosity**2 * prandtl
    shape = (1 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)
    nusselt: float = (0.60 + 0.387 * rayleigh ** (1 / 6) / shape) ** 2
    return nusselt * conductivity / diameter


def forced_convection(diameter: float, speed: float, surface: float, ambient: float) -> float:
    """Coefficient [W/(m2 K)] of a cylinder of this diameter [m] across a stream of this speed [m/s].

    Churchill and Bernstein, J. Heat Transfer 99 (1977) 300, doi 10.1115/1.3450685.
    """
    film = (surface + ambient) / 2 + _ZERO_C
    conductivity, viscosity, prandtl = (float(np.interp(film, _AIR[0], row)) for row in _AIR[1:])
    reynolds = speed * diameter / viscosity
    slope = 0.62 * reynolds**0.5 * prandtl ** (1 / 3) / (1 + (0.4 / prandtl) ** (2 / 3)) ** 0.25
    nusselt: float = 0.3 + slope * (1 + (reynolds / 282_000) ** 0.625) ** 0.8
    return nusselt * conductivity / diameter


def fan_heat_transfer_coefficient(diameter: float) -> float:
    """Coefficient [W/(m2 K)] of a wire of this diameter [m] in the stream of air in which the kit's has
    `SpringParameters.convection_fan`."""
    kit = SpringParameters()
    usual, own = (
        forced_convection(wire, _FAN_SPEED, kit.austenite_finish, kit.ambient)
        for wire in (kit.wire_diameter, diameter)
    )
    # Rounded: a diameter that was given in millimetres is off by a last digit.
    return round(own / usual, 9) * kit.convection_fan


def radiation(surface: float, ambient: float, emissivity: float) -> float:
    """Coefficient [W/(m2 K)] of a surface that sees surroundings at ambient temperature [C]."""
    hot, cold = surface + _ZERO_C, ambient + _ZERO_C
    return emissivity * _STEFAN_BOLTZMANN * (hot + cold) * (hot**2 + cold**2)


def wire_heat_transfer_coefficient(diameter: float, surface: float, ambient: float) -> float:
    """Expected coefficient [W/(m2 K)] of a straight wire of this diameter [m] in still air."""
    return free_convection(diameter, surface, ambient) + radiation(surface, ambient, EMISSIVITY)


def min_heat_transfer_coefficient(springs: SpringParameters, surface: float) -> float:
    """Smallest coefficient [W/(m2 K)] in still air that must be expected, related to the wire's surface.

    The smaller one of the wire alone and of the coil as a solid cylinder, extended by half of its stroke: a
    hot spring extends, but the robot loads it. Both with `CORRELATION_ERROR` less convection than the
    correlation gives.
    """
    wire, ambient = springs.wire_diameter, springs.ambient
    outer = springs.coil_diameter + wire
    length = springs.turns * wire + abs(springs.hot_length - springs.cold_length) / 2
    ratio = outer * length / (wire * springs.wire_length)  # of the wire's surface

    def coefficient(diameter: float) -> float:
        convection = (1 - CORRELATION_ERROR) * free_convection(diameter, surface, ambient)
        return convection + radiation(surface, ambient, MIN_EMISSIVITY)

    return min(coefficient(wire), coefficient(outer) * ratio)


def max_still_air_temperature(springs: SpringParameters, power: float) -> float:
    """Temperature [C] at which a spring with this heat [W] settles if it loses as little as possible."""
    surface = np.pi * springs.wire_diameter * springs.wire_length
    low, high = springs.ambient, springs.ambient + 1.0

    def excess(temperature: float) -> float:
        return power - min_heat_transfer_coefficient(springs, temperature) * surface * (
            temperature - springs.ambient
        )

    while excess(high) > 0 and high < _MAX_TEMPERATURE:
        low, high = high, springs.ambient + 2 * (high - springs.ambient)
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return high
