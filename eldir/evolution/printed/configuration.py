"""The configuration of a run that evolves printed robots: the same values give the same robots."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from pydantic import Field

from eldir.core import arguments
from eldir.core.records import Record, record
from eldir.evolution import defaults as paper
from eldir.evolution.printed import defaults
from eldir.evolution.printed.genome import Timing
from eldir.lattice import Lattice
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters

_MOST_MOTORS = 4


@record
class PrintedEvolutionConfig(Record):
    """How printed robots are evolved."""

    OPTIONAL = frozenset[str]()

    lattice: Lattice = field(default_factory=lambda: Lattice(*defaults.LATTICE))
    """Size of the lattice in which bodies lie."""
    offspring: Annotated[int, Field(ge=4, le=paper.MOST_POPULATION)] = defaults.OFFSPRING
    """New robots in a generation; six times as many random ones at the beginning."""
    generations: Annotated[int, Field(ge=0, le=paper.MOST_GENERATIONS)] = defaults.GENERATIONS
    """Generations of offspring after the random robots."""
    max_active: Annotated[int, Field(ge=1, le=_MOST_MOTORS)] = defaults.MOTORS
    """Largest number of motors."""
    static_margin: float = defaults.MARGIN
    """Least distance of the centre of mass from the edge of the feet [m]."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the run's random numbers."""
    printed: BuiltParameters = field(default_factory=BuiltParameters)
    """The nominal printed robot, with pins; the last trial gives it hubs, which take ten times as long."""
    springs: SpringParameters = field(default_factory=SpringParameters)
    """The nominal springs on the supply of the rig."""
    timings: tuple[Timing, ...] = tuple(Timing(*timing) for timing in defaults.TIMINGS)
    """Periods and times of heating that the rig allows."""

    def __post_init__(self) -> None:
        arguments.require_room(self.lattice.rows, self.lattice.columns, self.offspring)
        arguments.require_margin(
            "PrintedEvolutionConfig.static_margin",
            self.static_margin,
            self.lattice.columns,
            self.printed.pitch,
        )
        good = self.timings and all(0 < t.heating < t.period for t in self.timings)
        expected = "one or more of (period, heating) with 0 < heating < period [s]"
        arguments.require_value("PrintedEvolutionConfig.timings", good, expected, self.timings)

    @property
    def nominal(self) -> RobotParameters:
        """The nominal printed robot."""
        return RobotParameters(self.printed, self.springs)
