"""What evolves for building: a body, its motors, and when each motor is heated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eldir.built.gait import Gait
from eldir.built.gait_search import EVOLVED
from eldir.core.records import FloatArray, Record
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop


class Timing(NamedTuple):
    """Times of heating that a rig allows."""

    period: float
    """Period of the gait [s]."""
    heating: float
    """How long a motor is heated in each period [s]."""


@dataclass(frozen=True, eq=False)
class PrintedGenome(Record):
    """Genes of one printed robot."""

    genotype: Genotype
    phases: FloatArray
    """Start of heating of each lattice spring, as a fraction of the period, shape (lattice springs,). It is
    expressed where the spring is a motor."""
    timing: int
    """Index of the period and heating time in the run's list of them."""

    def __post_init__(self) -> None:
        self._set_array("phases", np.float64, (len(self.genotype.springs),))

    def body(self, lattice: Lattice) -> Morphology:
        """The developed body."""
        return develop(lattice, self.genotype)

    def gait(self, body: Morphology, timings: Sequence[Timing]) -> Gait:
        """The gait of the expressed motors; the first one begins at 0."""
        period, heating = timings[self.timing]
        own = self.phases[motors_of(body)]
        return Gait(period, (own - own[0]) % 1.0, np.full(len(own), heating / period), EVOLVED)


def motors_of(body: Morphology) -> np.ndarray:
    """Lattice springs of the motors, in the order of the body's springs, shape (A,)."""
    return body.lattice_springs[body.active]
