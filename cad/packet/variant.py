"""Changes of a design before it is built: a motor replaced by a passive spring, a weight added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_value
from eldir.design import Design, Variant
from eldir.genotype import Genotype


def apply(design: Design, variant: Variant) -> Design:
    """The design as it is built, with its `variant` and with the marks of the evolved design. Raises
    `InputError` for a motor that does not exist."""
    if variant == Variant():
        return design
    genotype, controller = design.genotype, design.controller
    motor = variant.without_motor
    if motor is not None:
        body = design.morphology
        require_value("without_motor", 0 <= motor < body.motors, f"0 to {body.motors - 1}", motor)
        springs = genotype.springs.copy()
        springs[body.lattice_springs[body.active][motor]] = False
        genotype = Genotype(genotype.triangles, springs)
        left = np.arange(body.motors) != motor
        controller = Controller(controller.w1, controller.b1, controller.w2[left], controller.b2[left])
    # The marks stay where they are: the control robot is compared with the design, mass by mass.
    marks = tuple(design.marks.tolist())
    return replace(design, genotype=genotype, controller=controller, variant=variant, kept_marks=marks)
