"""The configuration of a run that evolves printed robots, and the conditions of a workshop.

Printers and rigs live in packages above this one: `eldir_hardware.planning.workshop` knows them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from eldir import defaults
from eldir.built.ground import check_terrain
from eldir.core import arguments
from eldir.core.records import OMITTED, Record, record
from eldir.evolution.printed.genome import Timing
from eldir.lattice import Lattice
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir.terrain import Terrain

_MAX_MOTORS = 4
RejectionReason = Callable[[Morphology], str]
"""Says why a body cannot be built; empty if it can."""


@record
class PrintedEvolutionConfig(Record):
    """How printed robots are evolved."""

    OPTIONAL = frozenset({"terrain", "tolerances"})

    lattice: Lattice = field(default_factory=lambda: Lattice(*defaults.PRINTED_LATTICE))
    """Size of the lattice in which bodies lie."""
    offspring: Annotated[int, Field(ge=defaults.MIN_PRINTED_OFFSPRING, le=defaults.MAX_POPULATION)] = (
        defaults.PRINTED_OFFSPRING
    )
    """New robots in a generation; six times as many random ones at the beginning."""
    generations: Annotated[int, Field(ge=0, le=defaults.MAX_GENERATIONS)] = defaults.PRINTED_GENERATIONS
    """Generations of offspring after the random robots."""
    max_active: Annotated[int, Field(ge=1, le=_MAX_MOTORS)] = defaults.PRINTED_MOTORS
    """Largest number of motors."""
    static_margin: float = defaults.PRINTED_MARGIN
    """Least distance of the centre of mass from the edge of the feet [m]."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the run's random numbers."""
    printed: BuiltParameters = field(default_factory=BuiltParameters)
    """The nominal printed robot, with pins; the last trial gives it hubs, which take ten times as long."""
    springs: SpringParameters = field(default_factory=SpringParameters)
    """The nominal springs on the supply of the rig."""
    timings: tuple[Timing, ...] = tuple(Timing(*timing) for timing in defaults.PRINTED_TIMINGS)
    """Periods and times of heating that the rig allows."""
    terrain: Annotated[Terrain | None, OMITTED] = None
    """The ground [m, of the printed robot]; by default a table."""
    tolerances: Annotated[RigTolerances, Field(exclude_if=lambda value: value == RigTolerances())] = field(
        default_factory=RigTolerances
    )
    """Tolerances of the rig on which the samples walk; left out where they are those of a new rig file."""

    def __post_init__(self) -> None:
        if self.terrain is not None:
            check_terrain(self.terrain)
        arguments.require_memory(self.lattice.rows, self.lattice.columns, self.offspring)
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


@dataclass(frozen=True)
class BuildConditions:
    """Conditions that printed robots must keep, and their nominal parameters."""

    printed: BuiltParameters
    springs: SpringParameters
    """The springs on the rig's supply."""
    motors: int
    """Most motors that the rig can heat."""
    timings: tuple[Timing, ...]
    """Periods and times of heating that the rig allows."""
    rejection_reason: RejectionReason
    """Says why a body cannot be built; empty if it can."""
    buildable_motors: int
    """Most motors of a body that can be built."""
    min_static_margin: float
    """Least static margin of a body that can be built [m]."""
    tolerances: RigTolerances = field(default_factory=RigTolerances)
    """How far the springs of such a rig may be from nominal."""
