"""Uncertain parameters of a robot: each has a prior, and fields that it changes.

A parameter has a normalised value z: 0 is nominal, 1 is one standard deviation of its prior, which comes from
data sheets, geometry and printing (docs/reference/dynamics.md). All but the transition temperatures multiply
their fields by exp(z spread), so that no field changes its sign.

Three combinations change no motion: mass and stiffness by the same factor; heat capacity and heat flow by the
same factor; resistance against current. They are the parameters `weight`, `heat` and `resistance`, and the
other parameters are relative to them. Thus what no film can determine is three single parameters, not a
combination of many.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters

_Part = TypeVar("_Part", BuiltParameters, SpringParameters)
_PRINTED = ("hexagon", "half_connector", "strip")
_FORCES = (
    "tension", "buckling", "bending", "socket_friction", "active_damping", "cold_stiffness", "hot_stiffness",
)  # fmt: skip
_CONVECTION = ("convection_fan", "convection_still")
_SUPPLY = ("current_limit", "supply_voltage")
_RESISTANCES = ("resistivity_martensite", "resistivity_austenite", "lead_resistance")
_TRANSITIONS = ("austenite_finish", "austenite_start", "martensite_start", "martensite_finish")


@dataclass(frozen=True)
class UncertainParameter:
    """An uncertain parameter, with a normal prior of its normalised value z."""

    spread: float
    """Standard deviation of the prior: of the logarithm, or in [K] if the parameter is added."""
    powers: Mapping[str, float]
    """Fields of `BuiltParameters` and `SpringParameters` that the parameter multiplies, each with its
    exponent."""
    additive: bool = False
    """Whether the parameter is added to the fields instead."""
    unobservable: bool = False
    """Whether no motion depends on the parameter."""

    def at(self, part: _Part, z: float) -> _Part:
        """The parameters of the printed parts, or of the springs, after a change of `z` standard
        deviations."""
        changed: dict[str, Any] = {}
        for name, power in self.powers.items():
            if hasattr(part, name):
                value, step = float(getattr(part, name)), power * z * self.spread
                changed[name] = value + step if self.additive else value * float(np.exp(step))
        return replace(part, **changed)


def _all(*names: str, power: float = 1.0) -> dict[str, float]:
    return dict.fromkeys(names, power)


PARAMETERS: dict[str, UncertainParameter] = {
    "hot_length": UncertainParameter(0.15, _all("hot_length")),
    "cold_length": UncertainParameter(0.2, _all("cold_length")),
    "current": UncertainParameter(0.25, _all(*_SUPPLY)),
    "cooling": UncertainParameter(0.35, _all(*_CONVECTION)),
    "friction": UncertainParameter(0.35, _all("friction")),
    "cold_stiffness": UncertainParameter(0.35, _all("cold_stiffness")),
    "hot_stiffness": UncertainParameter(0.35, _all("hot_stiffness")),
    "latent_heat": UncertainParameter(0.05, _all("latent_heat")),
    "transition": UncertainParameter(1.0, _all(*_TRANSITIONS), additive=True),
    "tension": UncertainParameter(0.15, _all("tension")),
    "buckling": UncertainParameter(0.3, _all("buckling", "bending")),
    "strip_damping": UncertainParameter(0.5, _all("strip_damping")),
    "socket_friction": UncertainParameter(0.5, _all("socket_friction")),
    "active_damping": UncertainParameter(0.5, _all("active_damping")),
    "drag": UncertainParameter(0.5, _all("drag")),
    "spring_mass": UncertainParameter(0.04, _all("active_spring")),
    "weight": UncertainParameter(0.05, _all(*_PRINTED, "active_spring", *_FORCES), unobservable=True),
    "heat": UncertainParameter(
        0.03,
        _all("heat_capacity", "latent_heat", *_CONVECTION) | _all(*_SUPPLY, power=0.5),
        unobservable=True,
    ),
    "resistance": UncertainParameter(
        0.02,
        _all(*_RESISTANCES) | _all("current_limit", power=-0.5) | _all("supply_voltage", power=0.5),
        unobservable=True,
    ),
}
"""Uncertain parameters, by name. All others are assumed to be known."""


def applicable_parameters(
    printed: BuiltParameters, names: Sequence[str] = tuple(PARAMETERS)
) -> tuple[str, ...]:
    """The named parameters that change a robot with these joints: only hubs have friction in sockets."""
    absent = {field for field, value in printed.to_json().items() if value == 0}
    return tuple(n for n in names if not set(PARAMETERS[n].powers) <= absent)


def is_unobservable(name: str) -> bool:
    """Whether no motion depends on a parameter; false for single strips and springs."""
    return name in PARAMETERS and PARAMETERS[name].unobservable
