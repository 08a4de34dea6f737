"""The next gait of an adaptation: the one that is expected to improve the walk most; and a better supply."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from eldir.built.gait import Gait
from eldir.built.gait_search import GaitSearchResult, HeatingLimits, Stage, search_robust_gait, silent
from eldir.built.samples import (
    IdentifiedRobots,
    SampledWalks,
    sample_walks,
    simulate_most_probable,
    simulate_robots,
)
from eldir.built.scene import PrintedScene
from eldir.design import Design
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_calibration.adaptation.films import FilmedWalk
from eldir_calibration.adaptation.heat import (
    find_safe_current,
    peak_temperatures,
    planned_contact_shares,
    robots_of,
)
from eldir_calibration.adaptation.runs import AdaptationConfig, AdaptationRun, SupplyAdvice
from eldir_calibration.dynamics.belief import Belief
from eldir_calibration.identification.identification import RobotFilms
from eldir_hardware.planning.compiler import compile_schedule, extract_gait
from eldir_hardware.planning.plan import PlanConfig, heating_limits, plan, plan_gait
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.margins import rigs_with_narrower_tolerances
from eldir_hardware.schedule import ActuationSchedule

_MEMBERS = 16
"""Number of robots sampled from a prior, for the heat of their springs."""


class NoGaitError(Exception):
    """No gait is worth a run; the reason, for the user."""


def plan_run(
    design: Design,
    rig: Rig,
    plans: PlanConfig,
    runs: Sequence[AdaptationRun],
    films: Sequence[FilmedWalk],
    believed: Sequence[RobotParameters],
    config: AdaptationConfig,
    stage: Stage = silent,
) -> ActuationSchedule:
    """The schedule of the next run: the one that `eldir gait` makes for a robot without films, or that of the
    gait that is expected to walk farthest, of those that keep the springs of the `believed` robots cool.
    `runs`: those whose walks the supply can repeat. Raises `NoGaitError` if none is worth a run."""
    if plans.scene is None or not films:
        schedule = plan(design, rig, plans, stage)
        require_cool(design, rig, schedule, believed)
        return schedule
    filmed = plans.scene.filmed_of(design)
    robots = IdentifiedRobots.of(design, plans.scene)
    limits = believed_limits(design, rig, robots.robot.springs, believed)
    gait = search_robust_gait(robots, limits, filmed, plans.seed, stage)
    stage(f"predicting the walks of {config.samples} samples")
    (walks,) = sample_walks(robots, [gait], config.samples, plans.seed)
    best = max((run.filmed for run in runs if run.upright), default=0.0)  # of those that count
    bias, error = discrepancy(design, plans.scene, films, rig.spring_parameters().current_limit)
    predicted, deviation = walks.expected - bias, float(np.hypot(walks.spread_with_falls, error))
    gain = expected_improvement(predicted, deviation, best)
    if gain < config.min_gain:
        raise NoGaitError(
            f"no gait is expected to walk farther than {best:+.2f}: the best other one is predicted "
            f"{predicted:+.2f} (standard deviation {deviation:.2f})"
        )
    reason = f"expected improvement over {best:+.2f}: {gain:.2f} body lengths per five cycles"
    found = GaitSearchResult({"search": gait}, {"search": walks}, "search", reason=reason)
    schedule = plan_gait(design, rig, found, plans, stage)
    require_cool(design, rig, schedule, believed)
    return schedule


def believed_robots(
    design: Design, rig: Rig, scene: PrintedScene | None, belief: Belief | None
) -> list[RobotParameters]:
    """Robots that may be the one on the table. `belief`: that after the films; before them `scene`, what
    films of other robots tell. Empty where neither tells anything, such as a belief that does not explain its
    films."""
    if belief is not None:
        return robots_of(belief, rig.spring_parameters().current_limit) if belief.explains else []
    return [] if scene is None else IdentifiedRobots.of(design, scene).samples(_MEMBERS, 0)


def believed_limits(
    design: Design, rig: Rig, springs: SpringParameters, believed: Sequence[RobotParameters]
) -> HeatingLimits:
    """The rig's heating limits, which it proves for the springs that its file describes, less the gaits that
    would heat those of the `believed` robots above the same temperature. `springs`: those whose timing is
    tried where the usual one is not allowed."""
    limits = heating_limits(rig)
    if not believed:
        return limits
    known: dict[tuple[float, ...], bool] = {}  # phases change nothing: springs are heated one by one

    def allowed(gait: Gait) -> bool:
        if not limits.allowed(gait):
            return False
        times = (gait.period, *gait.duty.tolist())
        if times not in known:
            peak = _believed_peak(design, rig, compile_schedule(gait, rig), believed)
            known[times] = peak <= rig.limits.max_temperature_c
        return known[times]

    return replace(limits, springs=springs, allowed=allowed)


def require_cool(
    design: Design, rig: Rig, schedule: ActuationSchedule, believed: Sequence[RobotParameters]
) -> None:
    """Raise `NoGaitError` if a schedule would heat the springs of the `believed` robots above the rig file's
    limit, in their mean."""
    limit = rig.limits.max_temperature_c
    if believed and (peak := _believed_peak(design, rig, schedule, believed)) > limit:
        raise NoGaitError(
            f"in the next run the springs would reach {peak:.0f} C, by what the films tell, and the limit is "
            f"{limit:g} C. With a lower current the same command goes on"
        )


def _believed_peak(
    design: Design, rig: Rig, schedule: ActuationSchedule, believed: Sequence[RobotParameters]
) -> float:
    body = design.morphology
    return float(peak_temperatures(body, believed, planned_contact_shares(schedule, rig, body.motors)).mean())


def expected_improvement(mean: float, deviation: float, best: float) -> float:
    """Expected value of max(0, walk - best) of a normally distributed walk (Jones, Schonlau and Welch, J.
    Global Optimization 13 (1998) 455, eq. 15)."""
    if not np.isfinite(mean):
        return 0.0
    if deviation <= 0.0:
        return max(0.0, mean - best)
    u = (mean - best) / deviation
    return float((mean - best) * ndtr(u) + deviation * np.exp(-u * u / 2) / np.sqrt(2 * np.pi))


def discrepancy(
    design: Design, scene: PrintedScene, films: Sequence[FilmedWalk], current_limit_a: float
) -> tuple[float, float]:
    """How much farther the most probable robot walks than the filmed one, by all gaits filmed with this
    current limit, and the root mean square of the single differences, a fall counted as no motion [body
    lengths per five cycles]. As long as there is no such film, those with other currents count. Each walk is
    simulated with the current and in the air of its film.

    The first one is shrunk by n / (n + 1): one film tells half of it.
    """
    same = [one for one in films if one.current_limit_a == current_limit_a]
    counted, robots = same or list(films), IdentifiedRobots.of(design, scene)
    if not counted:
        return 0.0, 0.0
    differences = []
    for limit, air in dict.fromkeys(one[1:] for one in counted):
        own = [one.film for one in counted if one[1:] == (limit, air)]
        filmed = replace(robots, robot=in_air(scale_current(robots.robot, limit / current_limit_a), air))
        walks = simulate_most_probable(filmed, [film.gait for film in own], coarse=True)
        shown = np.array([0.0 if film.has_fallen else film.walked for film in own])
        differences.append(np.where(np.isfinite(walks), walks, 0.0) - shown)
    every = np.concatenate(differences)
    return float(every.sum() / (len(every) + 1)), float(np.sqrt(np.mean(every**2)))


def scale_current(robot: RobotParameters, factor: float) -> RobotParameters:
    """The same robot on a supply with this multiple of the current limit."""

    def changed(springs: SpringParameters) -> SpringParameters:
        return replace(springs, current_limit=springs.current_limit * factor)

    return replace(robot, springs=changed(robot.springs), own_springs=tuple(map(changed, robot.own_springs)))


def in_air(robot: RobotParameters, air_c: float | None) -> RobotParameters:
    """The same robot in air of this temperature [C]; None: in its own."""
    own = tuple(springs.in_air(air_c) for springs in robot.own_springs)
    return replace(robot, springs=robot.springs.in_air(air_c), own_springs=own)


class BestRun(NamedTuple):
    """The run in which the robot walked farthest."""

    schedule: ActuationSchedule
    film: RobotFilms


def advise_supply(
    design: Design,
    rig: Rig,
    best: BestRun,
    films: Sequence[FilmedWalk],
    scene: PrintedScene,
    belief: Belief,
    config: AdaptationConfig,
) -> tuple[SupplyAdvice, ...]:
    """What the belief predicts for the best schedule with the highest current that narrower tolerances and
    the believed springs allow, if that is more than the springs have now.

    A current that is to be measured is then what the supply is set to; without that it is off as it was in
    the films. With the advised one 95 % of the believed springs keep the limit in the warmest air that it is
    for, whatever the rig file says.
    """
    gait = extract_gait(best.schedule)
    assert gait is not None  # which was filmed
    robots, own = IdentifiedRobots.of(design, scene), rig.spring_parameters().current_limit
    samples, max_c = robots.samples(config.samples, config.seed), rig.limits.max_temperature_c
    present = float(np.mean([robot.springs.current_limit for robot in samples]))
    (bias, error), found = discrepancy(design, scene, films, own), []
    for other in rigs_with_narrower_tolerances(best.schedule, rig):
        allowed = other.tolerances
        measures = allowed.current_is_measured and not rig.tolerances.current_is_measured
        limit = find_safe_current(
            belief,
            best.film,
            max_c,
            other.spring_parameters().current_limit,
            above_a=present if measures else own,
            tolerance=allowed.current if measures else None,
            air_c=allowed.ambient_max_c,
        )
        if limit is None:
            continue
        changed = [
            scale_current(robot, limit / (robot.springs.current_limit if measures else own))
            for robot in samples
        ]
        walks = SampledWalks(simulate_robots(robots, changed, [gait], coarse=True)[0])
        known = np.isfinite(walks.mean)
        found.append(
            SupplyAdvice(
                allowed.current,
                allowed.ambient_min_c,
                allowed.ambient_max_c,
                limit,
                round(walks.expected - bias, 4) if known else None,
                round(float(np.hypot(walks.spread_with_falls, error)), 4) if known else None,
            )
        )
    return tuple(found)
