"""The configuration of a run that evolves printed robots: the same values give the same robots."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from eldir.core import run_limits
from eldir.core.records import Record
from eldir.errors import InputError
from eldir.evolution import defaults as paper
from eldir.evolution.printed import defaults
from eldir.evolution.printed.genome import Timing
from eldir.lattice import Lattice
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters

_MOST_MOTORS = 4


@dataclass(frozen=True, eq=False)
class PrintedEvolution(Record):
    """How printed robots are evolved."""

    lattice: Lattice = field(default_factory=lambda: Lattice(*defaults.LATTICE))
    offspring: int = defaults.OFFSPRING
    """New robots in a generation; six times as many random ones at the beginning."""
    generations: int = defaults.GENERATIONS
    max_active: int = defaults.MOTORS
    """Largest number of motors."""
    static_margin: float = defaults.MARGIN
    """Least distance of the centre of mass from the edge of the feet [m]."""
    seed: int = 0
    printed: BuiltParameters = field(default_factory=BuiltParameters)
    """The nominal printed robot, with pins; the last trial gives it hubs, which take ten times as long."""
    springs: SpringParameters = field(default_factory=SpringParameters)
    """The nominal springs on the supply of the rig."""
    timings: tuple[Timing, ...] = tuple(Timing(*timing) for timing in defaults.TIMINGS)
    """Periods and times of heating that the rig allows."""

    def __post_init__(self) -> None:
        for name, least, most in (
            ("offspring", 4, paper.MOST_POPULATION),
            ("generations", 0, paper.MOST_GENERATIONS),
            ("max_active", 1, _MOST_MOTORS),
            ("seed", 0, 2**63 - 1),
        ):
            run_limits.require_whole_number(f"PrintedEvolution.{name}", getattr(self, name), least, most)
        run_limits.require_room(self.lattice.rows, self.lattice.columns, self.offspring)
        run_limits.require_margin(
            "PrintedEvolution.static_margin", self.static_margin, self.lattice.columns, self.printed.pitch
        )
        timings = tuple(Timing(*map(float, timing)) for timing in self.timings)
        if not timings or not all(0 < t.heating < t.period < np.inf for t in timings):
            raise InputError(
                "PrintedEvolution.timings is wrong",
                expected="one or more of (period, heating) with 0 < heating < period [s]",
                found=str(self.timings),
            )
        object.__setattr__(self, "timings", timings)

    @property
    def nominal(self) -> RobotParameters:
        """The nominal printed robot."""
        return RobotParameters(self.printed, self.springs)

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of `from_json`."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return values | {
            "lattice": {"rows": self.lattice.rows, "columns": self.lattice.columns},
            "printed": self.printed.to_json(),
            "springs": asdict(self.springs),
            "timings": [list(timing) for timing in self.timings],
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> PrintedEvolution:
        """The inverse of `to_json`."""
        return cls(
            **values
            | {
                "lattice": Lattice(**values["lattice"]),
                "printed": BuiltParameters.from_json(values["printed"]),
                "springs": SpringParameters(**values["springs"]),
                "timings": tuple(Timing(*timing) for timing in values["timings"]),
            }
        )
