"""Screening of designs for building: static margin, then all phases with the nominal robot.

Fitness in the paper's simulation hardly predicts whether a robot walks when built (docs/reference/built.md).
Therefore every design that stands is driven with all relative phases of its motors: first with soft strips,
which allow longer steps; then the best designs again with the real strips.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np

from eldir.built.gait import CYCLES, DUTY, PERIOD, FreeLengths, Gait, free_lengths
from eldir.built.robot import SOFT_TENSION, build, count_mechanisms, find_shape_fault, static_margin
from eldir.built.walking import displacements
from eldir.core.records import FloatArray, Record
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.terrain import Terrain

MARGIN = 0.02
"""Required static margin [m]; 0.03 is safe."""
PHASES = 12
_SOFT_CYCLES = 2
_EXACT = 12  # designs that the second pass takes
_AT_ONCE = 8  # designs that are driven between two calls of `progress`


@dataclass(frozen=True, eq=False)
class ScreeningResult(Record):
    """Result of screening one design."""

    index: int
    """Index in the list that was screened."""
    margin: float
    """Static margin [m]."""
    mechanisms: int
    """Number of mechanisms with all springs in place; 0 for a robot that keeps its shape."""
    displacement: FloatArray
    """Displacement with each phase that was tried [body lengths per five cycles], shape (P,); empty if the
    design was not simulated."""
    gait: Gait | None
    """The best gait; None if the design was not simulated."""
    exact: bool
    """Whether the displacements come from the real strips."""
    rejected: str
    """Why the design was rejected; empty if it was not."""

    @property
    def best(self) -> float:
        """Largest displacement [body lengths per five cycles]; minus infinity if the design was rejected."""
        return float(self.displacement.max()) if len(self.displacement) else -np.inf


def candidate_gaits(motors: int, phases: int = PHASES) -> list[Gait]:
    """Gaits with all phases relative to the first motor, in steps of 1 / `phases` of the period."""
    steps = np.arange(phases) / phases
    return [
        Gait(PERIOD, np.array([0.0, *others]), np.full(motors, DUTY))
        for others in product(steps, repeat=motors - 1)
    ]


def screen(
    morphologies: Sequence[Morphology],
    parameters: BuiltParameters | None = None,
    springs: SpringParameters | None = None,
    phases: int = PHASES,
    progress: Callable[[float], None] | None = None,
    terrain: Terrain | None = None,
    ballasts: Sequence[FloatArray | float] = (),
) -> list[ScreeningResult]:
    """Screen every design; results are in input order. `progress` is called with the completed share.
    `terrain`: the ground, by default a table; the static margin is that on a table. `ballasts` of one plane
    [kg], for each design as `build` takes it; by default none."""
    p, spring = parameters or BuiltParameters(), springs or SpringParameters()
    free = (spring.cold_length, spring.hot_length)
    ballasts = ballasts or [0.0] * len(morphologies)
    found: list[ScreeningResult] = []
    for i, body in enumerate(morphologies):
        robot = build(body, RobotParameters(p, spring), ballast=ballasts[i])
        margin, loose = static_margin(robot), count_mechanisms(robot.positions, robot.springs)
        why = find_shape_fault(robot)
        if margin < MARGIN:
            why = f"static margin {margin * 1e3:.0f} mm, required {MARGIN * 1e3:.0f} mm"
        found.append(ScreeningResult(i, margin, loose, np.zeros(0), None, False, why))

    @cache
    def heated(motors: int, hubs: bytes, cycles: int) -> list[tuple[Gait, FreeLengths]]:
        of = np.frombuffer(hubs, np.int32).reshape(-1, 2) if hubs else None
        return [(g, free_lengths(g, spring, cycles, hubs=of)) for g in candidate_gaits(motors, phases)]

    # Only where heat passes between springs does it matter which of them meet.
    hubs_of = [m.motor_hubs.tobytes() if spring.neighbour_conductance else b"" for m in morphologies]

    def simulate_phases(chosen: list[int], parameters: BuiltParameters, cycles: int, exact: bool) -> None:
        for first in range(0, len(chosen), _AT_ONCE):
            together = chosen[first : first + _AT_ONCE]
            tables = [heated(morphologies[i].motors, hubs_of[i], cycles) for i in together]
            pairs = [(i, *pair) for i, own in zip(together, tables, strict=True) for pair in own]
            of = RobotParameters(parameters, spring)
            robots = {i: build(morphologies[i], of, ballast=ballasts[i]) for i in together}
            walks = displacements(
                [robots[i] for i, _, _ in pairs], [t for _, _, t in pairs], cycles, free, terrain=terrain
            )
            for i in together:
                tried = np.array([k for k, pair in enumerate(pairs) if pair[0] == i])
                best = pairs[tried[walks[tried].argmax()]][1]
                found[i] = replace(found[i], displacement=walks[tried], gait=best, exact=exact)
            if progress is not None:
                progress(0.5 * exact + 0.5 * (first + len(together)) / len(chosen))

    standing = [s.index for s in found if not s.rejected]
    simulate_phases(standing, _soften(p), _SOFT_CYCLES, False)
    simulate_phases(sorted(standing, key=lambda i: -found[i].best)[:_EXACT], p, CYCLES, True)
    return found


def _soften(parameters: BuiltParameters) -> BuiltParameters:
    return replace(parameters, tension=min(SOFT_TENSION, parameters.tension))


def simulate_soft_walks(
    morphologies: Sequence[Morphology], phases: int = PHASES, terrain: Terrain | None = None
) -> FloatArray:
    """The first pass alone: displacement of every design in its best phase, with soft strips [body lengths
    per five cycles], shape (n,); minus infinity if it fell or folded in all phases. `terrain` as in
    `screen`."""
    soft, spring = _soften(BuiltParameters()), SpringParameters()
    best = np.full(len(morphologies), -np.inf)
    for first in range(0, len(morphologies), _AT_ONCE):
        pairs = [
            (i, gait)
            for i in range(first, min(first + _AT_ONCE, len(morphologies)))
            for gait in candidate_gaits(morphologies[i].motors, phases)
        ]
        robots = [build(morphologies[i], soft) for i, _ in pairs]
        tables = [free_lengths(gait, spring, _SOFT_CYCLES) for _, gait in pairs]
        free = spring.cold_length, spring.hot_length
        walks = displacements(robots, tables, _SOFT_CYCLES, free, terrain=terrain)
        np.maximum.at(best, [i for i, _ in pairs], walks)
    return best
