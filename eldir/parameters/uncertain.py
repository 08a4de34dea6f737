"""What may differ between the drawing and the robot on the table: each with a scale, a prior and a place.

A knob is turned by z: 0 is nominal, 1 is one standard deviation of what data sheets, geometry and printing
leave open (docs/reference/dynamics.md). All but the transition temperatures scale their parameters by
exp(z spread), so that none changes its sign.

Three combinations move nothing: a robot that is heavier and as much stiffer, springs that take more heat and
get as much more, and springs that resist more and get as much less current. They have knobs of their own,
`weight`, `heat` and `resistance`, and the others count relative to them: what no film can tell is then a
direction of its own, instead of a valley across many.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters

Specimen = tuple[BuiltParameters, SpringParameters]
"""The printed part of a robot, and its shape-memory springs on their supply."""


@dataclass(frozen=True)
class Knob:
    """One thing that is not exactly known."""

    spread: float
    """Prior standard deviation of the logarithm; of temperatures [K]."""
    powers: Mapping[str, float]
    """Fields of `BuiltParameters` and `SpringParameters` that it scales, each with its exponent."""
    shifts: bool = False
    """It adds to them instead."""
    silent: bool = False
    """No motion tells it."""

    def turned(self, specimen: Specimen, z: float) -> Specimen:
        """Another specimen, off by `z` standard deviations of the prior."""
        built, springs = specimen
        return (
            replace(built, **self._changes(built, z)),
            replace(springs, **self._changes(springs, z)),
        )

    def _changes(self, part: BuiltParameters | SpringParameters, z: float) -> dict[str, Any]:
        changed: dict[str, Any] = {}
        for name, power in self.powers.items():
            if hasattr(part, name):
                value, turn = float(getattr(part, name)), power * z * self.spread
                changed[name] = value + turn if self.shifts else value * float(np.exp(turn))
        return changed


def _all(*names: str, power: float = 1.0) -> dict[str, float]:
    return dict.fromkeys(names, power)


_PRINTED = ("hexagon", "half_connector", "strip")
_FORCES = ("tension", "buckling", "bending", "active_damping", "cold_stiffness", "hot_stiffness")
_CONVECTION = ("convection_fan", "convection_still")
_SUPPLY = ("current_limit", "supply_voltage")
_RESISTANCES = ("resistivity_martensite", "resistivity_austenite", "lead_resistance")
_TRANSITIONS = ("austenite_finish", "austenite_start", "martensite_start", "martensite_finish")

KNOBS: dict[str, Knob] = {
    "hot_length": Knob(0.15, _all("hot_length")),
    "cold_length": Knob(0.2, _all("cold_length")),
    "current": Knob(0.25, _all(*_SUPPLY)),
    "cooling": Knob(0.35, _all(*_CONVECTION)),
    "friction": Knob(0.35, _all("friction")),
    "cold_stiffness": Knob(0.35, _all("cold_stiffness")),
    "hot_stiffness": Knob(0.35, _all("hot_stiffness")),
    "latent_heat": Knob(0.05, _all("latent_heat")),
    "transition": Knob(1.0, _all(*_TRANSITIONS), shifts=True),
    "tension": Knob(0.15, _all("tension")),
    "buckling": Knob(0.3, _all("buckling", "bending")),
    "strip_damping": Knob(0.5, _all("strip_damping")),
    "active_damping": Knob(0.5, _all("active_damping")),
    "drag": Knob(0.5, _all("drag")),
    "spring_mass": Knob(0.04, _all("active_spring")),
    "weight": Knob(0.05, _all(*_PRINTED, "active_spring", *_FORCES), silent=True),
    "heat": Knob(
        0.03, _all("heat_capacity", "latent_heat", *_CONVECTION) | _all(*_SUPPLY, power=0.5), silent=True
    ),
    "resistance": Knob(
        0.02,
        _all(*_RESISTANCES) | _all("current_limit", power=-0.5) | _all("supply_voltage", power=0.5),
        silent=True,
    ),
}
"""By name. What has no knob is taken as given."""


@dataclass(frozen=True)
class Quantity:
    """What a result lists."""

    unit: str
    parameter: str
    """Of `BuiltParameters` or `SpringParameters`."""
    shifts: bool = False
    """Its interval is symmetric about its value, not about its logarithm."""

    def value(self, specimen: Specimen) -> float:
        """In `unit`."""
        built, springs = specimen
        return float(getattr(built if hasattr(built, self.parameter) else springs, self.parameter))

    def by(self, names: Sequence[str]) -> FloatArray:
        """Change of its logarithm (of itself, where it shifts) with each knob's z, shape (knobs,)."""
        return np.array([KNOBS[n].spread * KNOBS[n].powers.get(self.parameter, 0.0) for n in names])


QUANTITIES: dict[str, Quantity] = {
    "hot_length": Quantity("m", "hot_length"),
    "cold_length": Quantity("m", "cold_length"),
    "current": Quantity("A", "current_limit"),
    "cooling": Quantity("W/(m2 K)", "convection_fan"),
    "friction": Quantity("1", "friction"),
    "cold_stiffness": Quantity("N/m", "cold_stiffness"),
    "hot_stiffness": Quantity("N/m", "hot_stiffness"),
    "heat_capacity": Quantity("J/(kg K)", "heat_capacity"),
    "latent_heat": Quantity("J/kg", "latent_heat"),
    "resistivity": Quantity("Ohm m", "resistivity_martensite"),
    "transition": Quantity("C", "austenite_finish", shifts=True),
    "tension": Quantity("N/m", "tension"),
    "buckling": Quantity("N", "buckling"),
    "strip_damping": Quantity("1", "strip_damping"),
    "active_damping": Quantity("N s/m", "active_damping"),
    "drag": Quantity("1/s", "drag"),
    "printed_mass": Quantity("kg", "hexagon"),
    "spring_mass": Quantity("kg", "active_spring"),
}
"""What results list, by name."""


def specimen(nominal: Specimen, names: Sequence[str], z: Sequence[float] | FloatArray) -> Specimen:
    """The nominal robot with some knobs turned, by standard deviations of their priors."""
    for name, turn in zip(names, z, strict=True):
        nominal = KNOBS[name].turned(nominal, float(turn))
    return nominal
