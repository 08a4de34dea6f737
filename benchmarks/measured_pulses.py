"""`python -m benchmarks.measured_pulses DESIGN...`: walks with timed and with measured pulses (decision 59).

Coarse robots, five cycles. Each way to heat has the largest current that its rig's limits allow. Ways with
the same times have the same phases, those that carry samples of the first of them farthest. A motor has one
spring here, by which its pulse ends.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks.pulses import (
    CORNERS,
    TIMER_MARGIN,
    TRANSFORMED,
    Allowed,
    Corner,
    Pulses,
    heat_measured,
    is_allowed,
    is_allowed_if_measured,
    make_rig,
    max_current,
    springs_at,
)
from eldir.built.gait import CONDITIONING, CYCLES, SETTLE, FreeLengths, Gait, read_gait
from eldir.built.robot import build
from eldir.built.samples import NominalRobots
from eldir.built.screening import candidate_gaits
from eldir.built.walking import displacements
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_hardware.rig.configuration import Rig

_DT = 0.05
_SAMPLES, _SEED = 64, 11
_SEARCH_SAMPLES, _SEARCH_SEED, _SEARCH_CYCLES = 8, 12, 1
_COLD_IN_TEMPLATE = "-5 %, +10 %, 18 C"
_MEASURED_CURRENT = {"current": 0.02}
_MEASURED_BOTH = {"current": 0.02, "ambient_max_c": 26.0}
_MEASURED_ALL = {"current": 0.02, "ambient_max_c": 26.0, "resistance_tolerance": 0.01}
_EXACT_TIMER = 0.1  # opens so long after the longest pulse [s]


@dataclass(frozen=True)
class Way:
    """A way to heat, and the rig for it."""

    pulses: Pulses
    allowed: Allowed = is_allowed
    tolerances: dict[str, float] = field(default_factory=dict)
    timer_margin: float = TIMER_MARGIN
    current: float | None = None
    """Current [A] where no limit of today's allows it."""

    @property
    def rig(self) -> Rig:
        """The rig at its largest current, rounded down to 0.05 A."""
        believed = self.allowed is is_allowed_if_measured
        pulses = self.pulses if believed else self.pulses._replace(ends_at=None)
        most = self.current or max_current(
            pulses, self.allowed, tuple(self.tolerances.items()), self.timer_margin
        )
        return make_rig(int(most * 20 + 1e-6) / 20, self.pulses.heating, self.timer_margin, **self.tolerances)


WAYS = {
    "timed, 6 s in 30 s": Way(Pulses(6, 30)),
    "measured, 6 s in 30 s": Way(Pulses(6, 30, TRANSFORMED)),
    "measured to 1 %, 6 s in 30 s": Way(Pulses(6, 30, 0.01)),
    "measured and believed, 6 s in 30 s": Way(Pulses(6, 30, TRANSFORMED), is_allowed_if_measured),
    "timed, 6 s in 20 s": Way(Pulses(6, 20)),
    "measured, 6 s in 20 s": Way(Pulses(6, 20, TRANSFORMED)),
    "measured and believed, 6 s in 20 s": Way(Pulses(6, 20, TRANSFORMED), is_allowed_if_measured),
    "timed, 6 s in 40 s": Way(Pulses(6, 40)),
    "measured, 6 s in 40 s": Way(Pulses(6, 40, TRANSFORMED)),
    "timed, 3 s in 30 s": Way(Pulses(3, 30)),
    "measured, 3 s in 30 s": Way(Pulses(3, 30, TRANSFORMED)),
    "timed, 3 s in 30 s, timer of 3.1 s": Way(Pulses(3, 30), timer_margin=_EXACT_TIMER),
    "timed, 2.4 s in 30 s, timer of 2.5 s": Way(Pulses(2.4, 30), timer_margin=_EXACT_TIMER),
    "timed, current to 2 %": Way(Pulses(6, 30), tolerances=_MEASURED_CURRENT),
    "measured, current to 2 %": Way(Pulses(6, 30, TRANSFORMED), tolerances=_MEASURED_CURRENT),
    "timed, current to 2 %, 18 to 26 C": Way(Pulses(6, 30), tolerances=_MEASURED_BOTH),
    "measured, current to 2 %, 18 to 26 C": Way(Pulses(6, 30, TRANSFORMED), tolerances=_MEASURED_BOTH),
    "timed, current to 2 %, 18 to 26 C, resistance to 1 %": Way(Pulses(6, 30), tolerances=_MEASURED_ALL),
    "timed, current to 2 %, 3 s in 30 s, timer of 3.1 s": Way(
        Pulses(3, 30), tolerances=_MEASURED_CURRENT, timer_margin=_EXACT_TIMER
    ),
    "timed, current to 2 %, 2.4 s in 30 s, timer of 2.5 s": Way(
        Pulses(2.4, 30), tolerances=_MEASURED_CURRENT, timer_margin=_EXACT_TIMER
    ),
    "measured, 12 s at most, a switch at each spring": Way(Pulses(12, 30, TRANSFORMED), current=3.6),
    "the same, 4 A": Way(Pulses(12, 30, TRANSFORMED), current=4.0),
}
"""What is compared. Pulses of two motors may overlap: 3 s at 4.6 A then take more than the template's 16 A.
The last two need a cut-off that opens by the temperature of each spring."""


class Robot:
    """A design, heated in one way."""

    def __init__(self, design: Design, way: Way):
        self._design, self._way, self._rig = design, way, way.rig
        nominal = RobotParameters(BuiltParameters().with_hubs(), self._rig.spring_parameters())
        self._robots = NominalRobots(
            design.morphology,
            nominal,
            design.ballast / 2,
            design.printed_terrain,
            self._rig.spring_tolerances(),
        )

    def find_gait(self) -> Gait:
        """The phases with which samples walk farthest, among the design's own and all relative ones."""
        period, motors = self._way.pulses.period, self._design.morphology.motors
        own = read_gait(self._design)
        phases = [g.phase for g in ([own] if own else []) + candidate_gaits(motors)]
        duty = np.full(motors, self._way.pulses.heating / period)
        samples = self._robots.samples(_SEARCH_SAMPLES, _SEARCH_SEED)
        gaits = [Gait(period, phase, duty) for phase in phases]
        means = [_with_falls(self._walks(samples, gait, _SEARCH_CYCLES)).mean() for gait in gaits]
        return gaits[int(np.argmax(means))]

    def walks_in_corners(self, gait: Gait) -> dict[str, float]:
        """Walk of the nominal robot at the ends of the rig's tolerances, and at the coldest of the template's
        [body lengths per five cycles]."""
        current = self._rig.supply.current_limit_a or 0.0
        cold = springs_at(make_rig(current), Corner(-1, 1, -1))
        springs = {name: springs_at(self._rig, corner) for name, corner in CORNERS.items()}
        springs[_COLD_IN_TEMPLATE] = cold
        robots = [replace(self._robots.robot, springs=own) for own in springs.values()]
        return dict(zip(springs, self._walks(robots, gait).tolist(), strict=True))

    def walks_of_samples(self, gait: Gait) -> FloatArray:
        """Walks of samples with the common errors of the rig's tolerances, a fall counted as no walk."""
        return _with_falls(self._walks(self._robots.samples(_SAMPLES, _SEED), gait))

    def _walks(self, robots: Sequence[RobotParameters], gait: Gait, cycles: int = CYCLES) -> FloatArray:
        body = self._design.morphology
        built = [build(body, robot, ballast=self._robots.ballast).coarse() for robot in robots]
        springs = [robot.motor_springs(body.motors) for robot in robots]
        tables = free_lengths_measured(gait, springs, self._way.pulses.ends_at, cycles)
        free = [self._robots.free_lengths_of(robot) for robot in robots]
        return displacements(built, tables, cycles, free, terrain=self._robots.terrain)


def free_lengths_measured(
    gait: Gait, robots: Sequence[Sequence[SpringParameters]], ends_at: float | None, cycles: int
) -> list[FreeLengths]:
    """Free lengths of the springs of each robot, whose pulses end at this martensite fraction; see
    `eldir.built.gait.free_lengths`."""
    motors, every = len(gait.phase), [spring for own in robots for spring in own]
    steps = round((SETTLE + gait.period * (cycles + CONDITIONING)) / _DT)
    planned = np.tile(gait.is_heating(np.arange(steps) * _DT - SETTLE + 1e-9), (1, len(robots)))
    history = heat_measured(planned, every, ends_at)
    lengths = np.concatenate([[[p.cold_length for p in every]], history.length])
    first = round((SETTLE + CONDITIONING * gait.period) / _DT)
    return [
        FreeLengths(_DT, lengths[:, column].copy(), history.temperature[:, column].copy(), first)
        for column in (slice(r * motors, (r + 1) * motors) for r in range(len(robots)))
    ]


def _with_falls(walks: FloatArray) -> FloatArray:
    return np.where(np.isfinite(walks), walks, 0.0)


def main() -> int:
    """Status 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measured_pulses", description=__doc__)
    parser.add_argument("designs", type=Path, nargs="+", metavar="DESIGN", help="design with an evolved gait")
    parser.add_argument(
        "--only", nargs="+", default=[""], metavar="TEXT", help="ways whose name has this text"
    )
    arguments = parser.parse_args()
    columns = [*CORNERS, _COLD_IN_TEMPLATE, "samples", "standard deviation", "5 %"]
    for path in arguments.designs:
        design = Design.load(path)
        print(f"\n| {path.parent.name} | current | " + " | ".join(columns))
        print("| --- | --- |" + " --- |" * len(columns))
        gaits: dict[tuple[float, float], Gait] = {}
        for name, way in WAYS.items():
            if not any(text in name for text in arguments.only):
                continue
            times, robot = way.pulses[:2], Robot(design, way)
            first = next(other for other in WAYS.values() if other.pulses[:2] == times)
            gait = gaits[times] = gaits.get(times) or Robot(design, first).find_gait()
            samples = robot.walks_of_samples(gait)
            found = [*robot.walks_in_corners(gait).values(), samples.mean(), samples.std(ddof=1)]
            cells = " | ".join(f"{walk:.2f}" for walk in [*found, float(np.quantile(samples, 0.05))])
            print(f"| {name} | {way.rig.supply.current_limit_a:.2f} A | {cells} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
