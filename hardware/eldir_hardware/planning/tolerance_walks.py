"""The walk at the ends of a rig's tolerances, and what narrower tolerances would allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldir.built.gait import Gait
from eldir.built.samples import RobotDistribution, simulate_robots
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import springs_at_tolerances
from eldir_hardware.safety.margins import coldest_peak_and_stroke, rigs_with_narrower_tolerances
from eldir_hardware.schedule import ActuationSchedule, NarrowerTolerances, ToleranceWalks


def simulate_tolerances(robots: RobotDistribution, gait: Gait, rig: Rig) -> ToleranceWalks:
    """Walks of the most probable robot at the ends of the rig's tolerances: of a coarse one on a table, of
    the robot as it is on a terrain, where coarse ones walk otherwise."""
    ends = [  # current, convection, room
        (0, 0, 0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1), (-1, 1, -1)
    ]  # fmt: skip
    off = [_robot_at_tolerances(robots.robot, rig, *end) for end in ends]
    nominal, *pairs, coldest = _walks(robots, off, gait)
    current, convection, room = zip(pairs[::2], pairs[1::2], strict=True)
    return ToleranceWalks(nominal, current, convection, room, coldest)


def simulate_narrower(
    robots: RobotDistribution, gait: Gait, schedule: ActuationSchedule, rig: Rig
) -> tuple[NarrowerTolerances, ...]:
    """What measured currents and air would allow, with the walk in the coldest corner that is left then."""
    rigs = list(rigs_with_narrower_tolerances(schedule, rig))
    if not rigs:
        return ()
    own = rig.spring_parameters().current_limit
    supplies = [other.spring_parameters().current_limit / own for other in rigs]
    cold = [
        _robot_at_tolerances(robots.robot, other, -1, 1, -1, supply)
        for other, supply in zip(rigs, supplies, strict=True)
    ]
    return tuple(
        NarrowerTolerances(
            other.tolerances.current,
            other.tolerances.ambient_min_c,
            other.tolerances.ambient_max_c,
            current_limit_a=other.spring_parameters().current_limit,
            coldest_stroke=coldest_peak_and_stroke(schedule, other)[1],
            coldest=walk,
        )
        for other, walk in zip(rigs, _walks(robots, cold, gait), strict=True)
    )


def describe_tolerances(walks: ToleranceWalks, rig: Rig) -> str:
    """The walks at the ends of the rig file's tolerances, in one line."""

    def name(walk: float | None) -> str:
        return "falls" if walk is None else f"{walk:+.2f}"

    allowed = rig.tolerances
    current, cooling = f"{allowed.current:.0%}", f"{allowed.convection_tolerance:.0%}"
    low, high = f"{allowed.ambient_min_c:g} C", f"{allowed.ambient_max_c:g} C"
    ends = (
        ("current", f"-{current}", f"+{current}", walks.current),
        ("cooling", f"-{cooling}", f"+{cooling}", walks.convection),
        ("air", low, high, walks.room),
    )
    each = "; ".join(f"{what} {a}: {name(x)}, {b}: {name(y)}" for what, a, b, (x, y) in ends)
    return (
        f"walk at the ends of the rig file's tolerances: {each}; least current, most cooling and coldest air "
        f"together: {name(walks.coldest)}; with the file's values: {name(walks.nominal)}"
    )


def describe_narrower(choices: tuple[NarrowerTolerances, ...], rig: Rig) -> list[str]:
    """What the supply may be turned up to if current and air are measured, with the walk in the coldest
    corner; no line where measuring allows nothing."""
    if not choices:
        return []
    lines = []
    for choice in choices:
        measured = describe_measured(choice.current, (choice.ambient_min_c, choice.ambient_max_c), rig)
        walk = "falls" if choice.coldest is None else f"{choice.coldest:+.2f}"
        lines.append(
            f"  if {measured}: {choice.current_limit_a:.2f} A; coldest corner: {walk}, "
            f"{choice.coldest_stroke:.0%} of the stroke"
        )
    return [
        "measured values allow a higher current limit; enter both in the rig file and plan again:",
        *lines,
    ]


def describe_measured(current: float, air: tuple[float, float], rig: Rig) -> str:
    """What must be measured for a tolerance of the current and a range of the air's temperature [C] that are
    narrower than the rig file's."""
    own, measured = rig.tolerances, []
    if current < own.current:
        measured.append(f"the current is known to {current:.0%}")
    if air != (own.ambient_min_c, own.ambient_max_c):
        measured.append(f"the air has {air[0]:g} to {air[1]:g} C")
    return " and ".join(measured)


def _robot_at_tolerances(
    robot: RobotParameters, rig: Rig, current: float, convection: float, room: float, supply: float = 1.0
) -> RobotParameters:
    """A robot whose springs are on a rig off by these parts of its tolerances. `supply`: factor on the
    supply's current limit."""

    def changed(springs: SpringParameters) -> SpringParameters:
        with_supply = replace(springs, current_limit=springs.current_limit * supply)
        return springs_at_tolerances(rig, with_supply, current, convection, room)

    return replace(robot, springs=changed(robot.springs), own_springs=tuple(map(changed, robot.own_springs)))


def _walks(robots: RobotDistribution, variants: Sequence[RobotParameters], gait: Gait) -> list[float | None]:
    """Walk of each variant [body lengths per five cycles]; None where it falls or folds."""
    (walks,) = simulate_robots(robots, variants, [gait], coarse=robots.terrain is None)
    return [round(float(walk), 6) if np.isfinite(walk) else None for walk in walks]
