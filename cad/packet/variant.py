"""A design built otherwise than evolved: a motor replaced by a passive spring, a weight added.

The paper's control robot has one motor fewer and 9 g in front.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from eldir.controller import Controller
from eldir.design import Design
from eldir.errors import InputError
from eldir.genotype import Genotype
from eldir.morphology import Morphology

_BALLAST = re.compile(r"(?P<grams>\d+(\.\d+)?)\s*g@(?P<place>front|rear|\d+)")
_MOST_GRAMS = 100.0


@dataclass(frozen=True)
class Ballast:
    """A weight shared equally by the same mass of both planes."""

    grams: float
    mass: int

    @classmethod
    def parse(cls, text: str, morphology: Morphology) -> Ballast:
        """From such as '9g@front', '5g@rear' or '4.5g@12' (a mass by its number)."""
        match = _BALLAST.fullmatch(text.strip())
        if match is None:
            raise InputError(
                "the ballast is not understood",
                expected="GRAMSg@PLACE with place front, rear or a mass's number, such as 9g@front",
                found=repr(text),
            )
        grams, place = float(match["grams"]), match["place"]
        if not 0 < grams <= _MOST_GRAMS:
            raise InputError(
                "the ballast has a strange weight", expected=f"0 to {_MOST_GRAMS:g} g", found=f"{grams:g} g"
            )
        if place in ("front", "rear"):
            x, y = np.round(morphology.positions, 9).T
            return cls(grams, int(np.lexsort((y, -x if place == "front" else x))[0]))
        mass, masses = int(place), len(morphology.positions)
        if mass >= masses:
            raise InputError(
                "the ballast hangs on a mass that is not there", expected=f"0 to {masses - 1}", found=place
            )
        return cls(grams, mass)


@dataclass(frozen=True)
class Variant:
    """How the built robot differs from its design."""

    without_motor: int | None = None
    """Number of the active spring that becomes passive, in the design's spring order from 0."""
    ballast: Ballast | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values; empty for the design as it is."""
        values: dict[str, Any] = {}
        if self.without_motor is not None:
            values["without_motor"] = self.without_motor
        if self.ballast is not None:
            values["ballast"] = {"grams": self.ballast.grams, "mass": self.ballast.mass}
        return values


def apply(design: Design, variant: Variant) -> Design:
    """The design as it is built; its provenance tells what was changed."""
    values = variant.to_json()
    if not values:
        return design
    genotype, controller = design.genotype, design.controller
    motor = variant.without_motor
    if motor is not None:
        body = design.morphology
        if not 0 <= motor < body.motors:
            raise InputError("there is no such motor", expected=f"0 to {body.motors - 1}", found=str(motor))
        springs = genotype.springs.copy()
        springs[body.lattice_springs[body.active][motor]] = False
        genotype = Genotype(genotype.triangles, springs)
        left = np.arange(body.motors) != motor
        controller = Controller(controller.w1, controller.b1, controller.w2[left], controller.b2[left])
    # The marks stay where they are: the control robot is compared with the design, mass by mass.
    provenance = design.provenance | {"variant": values, "marks": design.marks.tolist()}
    return Design(design.lattice, genotype, controller, design.scene, provenance)
