"""Random other robots, as in a first generation, for the null comparison of a report."""

from __future__ import annotations

import numpy as np

from eldir.built.robot import BuiltRobot, build
from eldir.core.records import IntArray
from eldir.design import Design
from eldir.genotype import random_genotypes
from eldir.marks import MARKS, marked_masses
from eldir.morphology import develop

OTHERS = 5
"""How many a report simulates: as many as it has time for."""
_SEED = 1


def other_robots(design: Design) -> list[tuple[BuiltRobot, IntArray]]:
    """Built robots of the same lattice with as many motors, and their marks; the same for every report."""
    rng = np.random.default_rng(_SEED)
    motors = design.morphology.motors
    found: list[tuple[BuiltRobot, IntArray]] = []
    for _ in range(20):
        for genotype in random_genotypes(design.lattice, 4 * OTHERS, rng, motors):
            body = develop(design.lattice, genotype)
            marks = marked_masses(body)
            if body.motors == motors and len(marks) == MARKS and len(found) < OTHERS:
                found.append((build(body), marks))
    return found
