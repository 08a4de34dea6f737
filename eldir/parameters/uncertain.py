"""Uncertain parameters of a robot: each has a prior, and fields that it changes.

A parameter has a normalised value z: 0 is nominal, 1 is one standard deviation of its prior, which comes from
data sheets, geometry and printing (docs/reference/dynamics.md). All but the transition temperatures multiply
their fields by exp(z spread), so that no field changes its sign. `BuiltParameters` and `SpringParameters` say
at their fields which there are (`eldir.parameters.annotations`).

Three combinations change no motion: mass and stiffness by the same factor; heat capacity and heat flow by the
same factor; resistance against current. They are the parameters `weight`, `heat` and `resistance`, and the
other parameters are relative to them. Thus what no film can determine is three single parameters, not a
combination of many.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from eldir.parameters.annotations import Prior, VariesWith, field_annotations
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters

_Part = TypeVar("_Part", BuiltParameters, SpringParameters)
_ORDER = (
    "hot_length", "cold_length", "current", "cooling", "friction", "cold_stiffness", "hot_stiffness", "heat",
    "latent_heat", "resistance", "transition", "tension", "buckling", "strip_damping", "socket_friction",
    "active_damping", "drag", "weight", "spring_mass",
)  # fmt: skip
"""Parameters in the order in which results list them, and random seeds give the same robots as before; later
parameters need no place in it."""


@dataclass(frozen=True, kw_only=True)
class UncertainParameter(Prior):
    """An uncertain parameter: its prior, and the fields that it changes."""

    field: str
    """Field of `BuiltParameters` or `SpringParameters` at which the prior stands, and which results list."""
    powers: Mapping[str, float]
    """All fields that the parameter multiplies, each with its exponent; or that it is added to."""

    def at(self, part: _Part, z: float) -> _Part:
        """The parameters of the printed parts, or of the springs, after a change of `z` standard
        deviations."""
        changed: dict[str, Any] = {}
        for name, power in self.powers.items():
            if hasattr(part, name):
                value, step = float(getattr(part, name)), power * z * self.spread
                changed[name] = value + step if self.additive else value * float(np.exp(step))
        return replace(part, **changed)


def read_parameters(*records: type) -> list[UncertainParameter]:
    """The parameters of records, in the order of the fields at which their priors stand. Raises `TypeError`
    where a parameter has its prior at no field, or at two."""
    powers: dict[str, dict[str, float]] = {}
    for field, other in chain.from_iterable(field_annotations(record, VariesWith) for record in records):
        powers.setdefault(other.parameter, {})[field] = other.power
    found = []
    for field, prior in chain.from_iterable(field_annotations(record, Prior) for record in records):
        name = prior.name or field
        values = vars(prior) | {"name": name, "quantity": prior.quantity or name, "field": field}
        found.append(UncertainParameter(**values, powers={field: 1.0} | powers.pop(name, {})))
    if powers or len({p.name for p in found}) < len(found):
        text = ", ".join(powers) or ", ".join(p.name for p in found)
        raise TypeError(f"every parameter must have its prior at one field: {text}")
    return found


def _rank(parameter: UncertainParameter) -> int:
    return _ORDER.index(parameter.name) if parameter.name in _ORDER else len(_ORDER)


_FOUND = read_parameters(BuiltParameters, SpringParameters)
LISTED = sorted(_FOUND, key=_rank)
"""Uncertain parameters, in the order in which results list their quantities."""
PARAMETERS: dict[str, UncertainParameter] = {
    p.name: p for p in sorted(_FOUND, key=lambda p: (p.unobservable, 0 if p.unobservable else _rank(p)))
}
"""Uncertain parameters, by name; those that change no motion last. All others are assumed to be known."""


def applicable_parameters(
    printed: BuiltParameters, names: Sequence[str] = tuple(PARAMETERS)
) -> tuple[str, ...]:
    """The named parameters that change a robot with these joints: only hubs have friction in sockets."""
    absent = {f.name for f in fields(printed) if not printed.acts(f.name) or getattr(printed, f.name) == 0}
    return tuple(n for n in names if not set(PARAMETERS[n].powers) <= absent)


def is_unobservable(name: str) -> bool:
    """Whether no motion depends on a parameter; false for single strips and springs."""
    return name in PARAMETERS and PARAMETERS[name].unobservable
