"""Errors of heating that all springs of a rig have in common: of supply, air, room, and their wire.

A spring's own deviations are independent of the others' and mostly cancel in a walk
(`RigTolerances.perturb_one`). Common ones do not: pulses end on the steep part of the transformation, where a
little less heat is much less stroke.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir.core.records import Record, record
from eldir.parameters.annotations import Tolerance, field_annotations
from eldir.parameters.bench import RESISTANCE_TOLERANCE
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import PARAMETERS

_MAX_DEVIATION = 2.0  # standard deviations: a tolerance is a bound


@record
class RigTolerances(Record):
    """How far what heats and cools the springs of a rig may be from its nominal values; two standard
    deviations each. The defaults are those of a new rig file."""

    current: Annotated[float, Field(ge=0, le=0.5)] = 0.05
    """Relative tolerance of the current."""
    convection: Annotated[float, Field(ge=0, le=0.9)] = 0.1
    """Relative tolerance of the convection coefficients."""
    ambient_min: float = 18.0
    """Lowest temperature of the air [C]."""
    ambient_max: float = 30.0
    """Highest temperature of the air [C]."""
    transition: Annotated[float, Field(ge=0)] = 2 * PARAMETERS["transition"].spread
    """Tolerance of the transition temperatures of a batch of wire [K]."""
    stroke: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """Relative tolerance of the stroke of a batch of springs, which depends on their training."""
    resistance: Annotated[float, Field(ge=0, le=0.5)] = RESISTANCE_TOLERANCE
    """Relative tolerance of the resistance of a spring, which springs do not have in common."""

    def perturb(self, springs: SpringParameters, rng: np.random.Generator) -> SpringParameters:
        """The springs on another rig of the same kind, of wire from another batch; each number is off by at
        most two standard deviations."""
        z = np.clip(rng.standard_normal(5), -_MAX_DEVIATION, _MAX_DEVIATION)
        current, convection, room, transition, stroke = (float(value) for value in z)
        changes = {
            "current": math.log1p(self.current / 2 * current),
            "cooling": math.log1p(self._common_convection * convection),
            "transition": self.transition / 2 * transition,
        }
        for name, change in changes.items():
            springs = PARAMETERS[name].at(springs, change / PARAMETERS[name].spread)
        end = self.ambient_max if room > 0 else self.ambient_min
        return replace(
            springs,
            ambient=springs.ambient + abs(room) / 2 * (end - springs.ambient),
            hot_length=springs.hot_length
            + self.stroke / 2 * stroke * (springs.hot_length - springs.cold_length),
        )

    def perturb_by_seed(self, springs: SpringParameters, seed: int) -> SpringParameters:
        """The springs on the virtual rig of a seed."""
        return self.perturb(springs, np.random.default_rng([seed, 5]))

    def perturb_one(self, springs: SpringParameters, rng: np.random.Generator) -> SpringParameters:
        """One spring of a rig whose `springs` have their errors in common. Its own standard deviations of
        resistance and convection are at most half of these tolerances, so that a rig measured well has
        springs as alike as its file says."""
        convection = self.convection / 2
        bounds = {
            "resistance": self.resistance / 2,
            "convection_fan": convection,
            "convection_still": convection,
        }
        return springs.perturb(rng, bounds)

    @property
    def _common_convection(self) -> float:
        """Standard deviation that all springs have in common; with each spring's own deviation it is half of
        the tolerance."""
        both = self.convection / 2
        own = min(dict(field_annotations(SpringParameters, Tolerance))["convection_fan"].spread, both)
        return math.sqrt(both**2 - own**2)
