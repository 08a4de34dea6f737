"""Where a physical parameter acts, and how far it may be from its nominal value, said at its field.

    friction: Annotated[NonNegativeFloat, Prior(0.35, "resin on an unknown table"), Tolerance(0.3, "uniform")]

A `Prior` is that of one robot before any film: its nominal values may be wrong. It makes the field a
parameter of identification, of samples and of results; a field that changes with another one's parameter says
`VariesWith`. A `Tolerance` is between robots of one print, and springs of one batch, whose nominal values are
right. A `LargeSpread` is that of virtual rigs that are to be identified. All: docs/reference/dynamics.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, Literal, TypeVar, get_type_hints

import numpy as np

_Annotation = TypeVar("_Annotation")
_LIMIT = 2.0
"""Relative and absolute tolerances are normal distributions that end at so many standard deviations."""


@dataclass(frozen=True)
class Prior:
    """Annotation of a field: it is uncertain, with a normal prior of its normalised value z."""

    spread: float
    """Standard deviation of the prior: of the logarithm, or in the field's unit if the parameter is added."""
    reason: str
    """Where the spread comes from."""
    name: str = ""
    """Name of the parameter, by default the field's."""
    quantity: str = ""
    """Name of the field in results, by default the parameter's."""
    between_springs: float | None = None
    """The same between the springs of one robot; None: they do not differ in it."""
    additive: bool = False
    """Whether the parameter is added to the fields instead of multiplying them."""
    unobservable: bool = False
    """Whether no motion depends on the parameter."""


@dataclass(frozen=True)
class VariesWith:
    """Annotation of a field that changes with a parameter whose `Prior` stands at another field."""

    parameter: str
    power: float = 1.0
    """Exponent with which the field changes."""


@dataclass(frozen=True)
class Tolerance:
    """Annotation of a field that differs between robots of one print, or springs of one batch."""

    spread: float
    """Standard deviation of the logarithm, of the ratio to the nominal value, or of the difference from it;
    half the width of a uniform distribution of the ratio."""
    form: Literal["log-normal", "uniform", "relative", "absolute"] = "log-normal"
    shared: str = ""
    """Name of a random number that fields have in common; by default each has its own."""
    joints: str = ""
    """`Joints` with which it counts, instead of a tolerance for all; by default all."""
    attribute: str = ""
    """Computed attribute of the record that differs instead of the field."""

    def sample(self, rng: np.random.Generator) -> float:
        """A random factor, or, if absolute, a random difference."""
        if self.form == "log-normal":
            return float(np.exp(self.spread * rng.standard_normal()))
        if self.form == "uniform":
            return float(rng.uniform(1 - self.spread, 1 + self.spread))
        change = self.spread * float(np.clip(rng.standard_normal(), -_LIMIT, _LIMIT))
        return change if self.form == "absolute" else 1.0 + change

    def apply(self, value: float, change: float) -> float:
        """The value after what `sample` gave."""
        return value + change if self.form == "absolute" else value * change


class ActsWith:
    """Annotation of a field that acts with these joints alone."""

    def __init__(self, *joints: str):
        self.joints = joints


@dataclass(frozen=True)
class LargeSpread:
    """Annotation of a field by which a virtual rig with `parameter_spread: large` is far from nominal."""

    low: float
    """Smallest relative change, to either side."""
    high: float
    """Largest relative change."""

    def sample(self, rng: np.random.Generator) -> float:
        """A random factor."""
        return float(1 + rng.choice([-1, 1]) * rng.uniform(self.low, self.high))


@cache
def field_annotations(kind: type, wanted: type[_Annotation]) -> tuple[tuple[str, _Annotation], ...]:
    """What the fields of a record say of this sort, each with its field's name, in the fields' order."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(
        (field.name, entry)
        for field in fields(kind)
        for entry in getattr(hints[field.name], "__metadata__", ())
        if isinstance(entry, wanted)
    )


def vary(
    part: Any,
    rng: np.random.Generator,
    first: Sequence[str] = (),
    max_spreads: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Random values within the tolerances of a record, by field. The fields in `first` are sampled in this
    order, what depends on the joints last; then all others in the order of the record. `max_spreads`: bounds
    of the spreads of some fields."""
    bounds = max_spreads or {}

    def rank(entry: tuple[str, Tolerance]) -> tuple[bool, bool, int]:
        name, tolerance = entry
        known = name in first
        return not known, bool(tolerance.joints), first.index(name) if known else 0

    kind: type = type(part)
    changes: dict[object, float] = {}
    values: dict[str, float] = {}
    for field, tolerance in sorted(field_annotations(kind, Tolerance), key=rank):
        if not tolerance.joints or tolerance.joints == part.joints:
            key, name = tolerance.shared or (field, tolerance), tolerance.attribute or field
            if key not in changes:
                spread = min(tolerance.spread, bounds.get(name, tolerance.spread))
                changes[key] = replace(tolerance, spread=spread).sample(rng)
            values[name] = tolerance.apply(getattr(part, name), changes[key])
    return values
