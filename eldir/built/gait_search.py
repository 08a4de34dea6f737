"""Search for the gait that carries a printed robot farthest forward, within the heating limits of a rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from eldir.built.gait import FilmedGait, Gait, read_gait
from eldir.built.gait_choice import choose_gait
from eldir.built.samples import (
    SAMPLES,
    IdentifiedRobots,
    NominalRobots,
    RobotDistribution,
    SampledWalks,
    sample_walks,
    simulate_most_probable,
)
from eldir.built.scene import PrintedScene
from eldir.built.screening import candidate_gaits
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir.rollout import simulate_one

Stage = Callable[[str], None]
"""A function that is called with what is computed next, in words."""
EVOLVED = "evolved"
"""Method of a gait that evolved with its design."""
_SAMPLES = 8  # robots that try each period and duty
_CYCLES = 1  # counted cycles where a gait is chosen
_NEAR = 0.05  # change of phase that other times may need: half the width of the peak
_LONGER, _SHORTER = 1.25, 0.85
_PREDICTING = "predicting the walks of {} samples"
_OTHER_TIMES = "simulating other periods and times of heating"


def silent(what: str) -> None:
    """Ignore what is computed."""


@dataclass(frozen=True)
class HeatingLimits:
    """Heating limits of a rig."""

    springs: SpringParameters
    """The nominal spring on the rig's supply."""
    allowed: Callable[[Gait], bool]
    """A function that says whether a gait keeps all limits of the rig."""
    timing: Callable[[SpringParameters, int], tuple[float, float]]
    """A function that gives the shortest period [s] and the duty in which these springs use their whole
    stroke, for a number of motors."""
    tolerances: RigTolerances = field(default_factory=RigTolerances)
    """The rig's tolerances."""
    power_shares: tuple[float, ...] = ()
    """Power of a spring while n springs heat, as `eldir.built.gait.free_lengths_batch` takes it."""


@dataclass(frozen=True)
class GaitSearchResult:
    """The gaits of a design on a rig, with the walks predicted for them."""

    gaits: dict[str, Gait]
    """Gaits by method: "evolved" or "search", "imitate" and, if a filmed gait is kept, "filmed"."""
    walks: dict[str, SampledWalks]
    """Predicted walks, by the same methods."""
    method: str
    """Method of the chosen gait."""
    kept_film: FilmedGait | None = None
    """The filmed gait, if it is kept; otherwise None."""
    reason: str = ""
    """Why a filmed gait is kept or not, in one line; empty without films."""

    @property
    def gait(self) -> Gait:
        """The chosen gait."""
        return self.gaits[self.method]


def find_gait(
    design: Design,
    limits: HeatingLimits,
    *,
    imitate: bool = False,
    seed: int = 0,
    samples: int = SAMPLES,
    scene: PrintedScene | None = None,
    other_than: Sequence[Gait] = (),
    stage: Stage = silent,
) -> GaitSearchResult:
    """Search a gait or take the one that evolved with the design, predict its walk, and choose. With
    `imitate` the closed loop is imitated too, and its gait chosen.

    `other_than`: gaits of which the chosen one must differ (`Gait.is_near`), such as those that were filmed.
    Raises `InputError` where the rig allows none.

    With a `scene` from films, gaits are searched and predicted for robots sampled from it. A filmed gait that
    walked is kept, unless another one is better by more than the required margin (`eldir.built.gait_choice`).
    `samples`: robots for which each walk is predicted. `stage` is called with what is computed next. The same
    seed gives the same result.
    """
    if other_than:
        return _find_other_gait(design, limits, other_than, seed, samples, scene, stage)
    filmed = [] if scene is None else [f for f in scene.filmed_of(design) if limits.allowed(f.gait)]
    if scene is None and (own := read_gait(design)) is not None and own.method == EVOLVED:
        return _find_evolved_gait(design, limits, own, imitate, seed, samples, stage)
    if scene is None:
        robots, searched = nominal_robots(design, limits), search_gait(design, limits, seed, stage)
    else:
        robots = identified_robots(design, limits, scene, filmed)
        searched = search_robust_gait(robots, limits, filmed, seed, stage)
    gaits = {"search": searched} | ({"imitate": imitate_gait(design)} if imitate else {})
    found = sample_walks_in_turn(
        robots, list(gaits.values()), samples, seed, stage, _PREDICTING.format(samples)
    )
    walks = dict(zip(gaits, found, strict=True))
    if imitate:
        return GaitSearchResult(gaits, walks, "imitate")
    if scene is None:
        return GaitSearchResult(gaits, walks, "search")
    chosen = choose_gait(design, searched, walks["search"], filmed, scene)
    if chosen.kept_film is None:
        return GaitSearchResult(gaits, walks, "search", reason=chosen.reason)
    gaits["filmed"] = chosen.gait
    (walks["filmed"],) = sample_walks(robots, [chosen.gait], samples, seed)
    return GaitSearchResult(gaits, walks, "filmed", chosen.kept_film, chosen.reason)


def _find_other_gait(
    design: Design,
    limits: HeatingLimits,
    other_than: Sequence[Gait],
    seed: int,
    samples: int,
    scene: PrintedScene | None,
    stage: Stage,
) -> GaitSearchResult:
    def allowed(gait: Gait) -> bool:
        return limits.allowed(gait) and not any(gait.is_near(other) for other in other_than)

    others = replace(limits, allowed=allowed)
    if scene is None:
        robots, found = nominal_robots(design, limits), search_gait(design, others, seed, stage)
    else:
        robots = identified_robots(design, limits, scene, scene.filmed_of(design))
        found = search_robust_gait(robots, others, (), seed, stage)
    if not allowed(found):
        raise InputError(
            "the rig allows no gait that differs enough",
            code="gait.no-other",
            expected="another phase, period or time of heating by a tenth",
            remedy="film a robot with two motors, or change the rig's limits",
        )
    walks = sample_walks_in_turn(robots, [found], samples, seed, stage, _PREDICTING.format(samples))
    return GaitSearchResult({"search": found}, {"search": walks[0]}, "search")


def _find_evolved_gait(
    design: Design, limits: HeatingLimits, own: Gait, imitate: bool, seed: int, samples: int, stage: Stage
) -> GaitSearchResult:
    robots = nominal_robots(design, limits)
    stage("fitting the evolved gait to the rig")
    kept, reason = fit_evolved_gait(robots, own, limits, seed)
    gaits = {EVOLVED: kept} | ({"imitate": imitate_gait(design)} if imitate else {})
    found = sample_walks_in_turn(
        robots, list(gaits.values()), samples, seed, stage, _PREDICTING.format(samples)
    )
    method = "imitate" if imitate else EVOLVED
    return GaitSearchResult(gaits, dict(zip(gaits, found, strict=True)), method, reason=reason)


def fit_evolved_gait(
    robots: RobotDistribution, own: Gait, limits: HeatingLimits, seed: int = 0
) -> tuple[Gait, str]:
    """The evolved gait if the rig allows it, or else the best one with other times that the rig allows, and
    what the rig took away, in one line.

    An allowed gait is not searched anew: evolution has evaluated it with up to 32 samples, and the best of
    several estimates from eight samples was worse (decision 38).
    """
    if limits.allowed(own):
        return own, ""
    motors = len(own.phase)
    near = [own, *(_shift_phase(own, m, by) for m in range(1, motors) for by in (-_NEAR, _NEAR))]
    allowed = [g for gait in near for g in _retime(gait, limits, limits.springs)]
    if not allowed:
        return own, ""  # the compiler says which limit forbids it
    # Other samples than those for which the walk is then predicted.
    walks = sample_walks(robots, allowed, _SAMPLES, seed + 1, cycles=_CYCLES, coarse=True)
    best = allowed[int(np.argmax([found.fitness for found in walks]))]
    reason = f"the rig does not allow the evolved {_describe_times(own)}; {_describe_times(best)} instead"
    return best, reason


def _shift_phase(gait: Gait, motor: int, by: float) -> Gait:
    """The gait with another phase of one motor."""
    phase = gait.phase.copy()
    phase[motor] = (phase[motor] + by) % 1.0
    return replace(gait, phase=phase)


def _describe_times(gait: Gait) -> str:
    return f"{gait.duty[0] * gait.period:.1f} s of heating in {gait.period:g} s"


def search_gait(design: Design, limits: HeatingLimits, seed: int = 0, stage: Stage = silent) -> Gait:
    """The gait whose phases carry the nominal printed robot farthest forward, and whose period and duty carry
    samples around it farthest. A robot that falls counts as not walking.

    All relative phases are tried at the usual period and duty; the best of them again at the springs'
    own timing, with longer pauses and with shorter heating. One cycle counts, of coarse robots
    (`PrintedRobot.coarse`): the walk that is predicted for the chosen gait is simulated anew.
    """
    stage("simulating the printed robot with all phases")
    robots, phases = nominal_robots(design, limits), _phases(design.morphology.motors, limits)
    best = phases[int(np.argmax(simulate_most_probable(robots, phases, cycles=_CYCLES, coarse=True)))]
    tried = [best, *_retime(best, limits, limits.springs)]
    tried = [gait for gait in tried if limits.allowed(gait)] or tried
    # Other samples than those for which the walk is then predicted.
    sampled = sample_walks_in_turn(
        robots, tried, _SAMPLES, seed + 1, stage, _OTHER_TIMES, cycles=_CYCLES, coarse=True
    )
    return tried[int(np.argmax([found.expected for found in sampled]))]


def sample_walks_in_turn(
    robots: RobotDistribution,
    gaits: Sequence[Gait],
    samples: int,
    seed: int,
    stage: Stage,
    what: str,
    cycles: int | None = None,
    coarse: bool = False,
) -> list[SampledWalks]:
    """`sample_walks`, gait by gait: where springs cool slowly, each takes a minute or more."""
    found: list[SampledWalks] = []
    for number, gait in enumerate(gaits, start=1):
        stage(f"{what}: gait {number} of {len(gaits)}, {gait.period:g} s a cycle")
        found += sample_walks(robots, [gait], samples, seed, cycles=cycles, coarse=coarse)
    return found


def search_robust_gait(
    robots: RobotDistribution,
    limits: HeatingLimits,
    filmed: Sequence[FilmedGait] = (),
    seed: int = 0,
    stage: Stage = silent,
) -> Gait:
    """The gait with the phases, and then the period and duty, that carry identified robots farthest forward
    on average.

    The expected walk of a gait is at most that of the most probable robot. The `filmed` gaits are left out:
    the camera has measured their walks. Robots are coarse (`PrintedRobot.coarse`).
    """

    def evaluate(gaits: list[Gait]) -> list[_EvaluatedGait]:
        # Other samples than those for which the walk is then predicted.
        sampled = sample_walks(robots, gaits, _SAMPLES, seed + 1, coarse=True)
        itself = simulate_most_probable(robots, gaits, coarse=True).tolist()
        every = zip(sampled, itself, gaits, strict=True)
        return [_EvaluatedGait(min(walks.expected, one), walks.expected, gait) for walks, one, gait in every]

    stage("simulating identified robots with all phases")
    tried = evaluate(_phases(robots.morphology.motors, limits))
    best = max(tried, key=_EvaluatedGait.fitness)
    if others := _retime(best.gait, limits, robots.robot.springs):
        stage(_OTHER_TIMES)
        tried += evaluate(others)
    new = [
        one for one in tried if limits.allowed(one.gait) and not any(film.shows(one.gait) for film in filmed)
    ]
    return max(new or tried, key=_EvaluatedGait.fitness).gait


def imitate_gait(design: Design) -> Gait:
    """The gait with the phases of the design's closed-loop rollout."""
    rollout = simulate_one(design.morphology, design.controller, design.scene)
    return Gait.from_rollout(rollout, design.scene)


class _EvaluatedGait(NamedTuple):
    """A gait with its expected walk [body lengths per five cycles]."""

    expected: float
    """Expected walk: the smaller of two values, of the most probable robot and of the samples around it."""
    of_samples: float
    """Expected walk of the samples alone."""
    gait: Gait

    def fitness(self) -> tuple[float, float]:
        """Key for the ranking of gaits. If the most probable robot falls with all gaits, the samples
        decide."""
        return self.expected, self.of_samples


def _phases(motors: int, limits: HeatingLimits) -> list[Gait]:
    """Gaits with all relative phases that the rig allows, at the usual period and duty, or else at its
    springs' own timing. If the rig allows none, all of them."""
    usual = candidate_gaits(motors)
    if allowed := [g for g in usual if limits.allowed(g)]:
        return allowed
    period, duty = limits.timing(limits.springs, motors)
    slower = [replace(g, period=period, duty=np.full(motors, duty)) for g in usual]
    return [g for g in slower if limits.allowed(g)] or slower


def _retime(gait: Gait, limits: HeatingLimits, springs: SpringParameters) -> list[Gait]:
    """Gaits with the same phases at the springs' own timing, with longer pauses and with shorter heating, as
    far as the rig allows."""
    motors = len(gait.phase)
    period, duty = limits.timing(springs, motors)
    times = [
        (period, duty),
        (round(_LONGER * period, 1), duty / _LONGER),
        (gait.period, _SHORTER * gait.duty[0]),
    ]
    others = [replace(gait, period=p, duty=np.full(motors, d)) for p, d in times]
    return [g for g in others if limits.allowed(g)]


def nominal_robots(design: Design, limits: HeatingLimits) -> RobotDistribution:
    """Nominal robots of a design without films, with hubs, on the rig's supply."""
    robot = RobotParameters.nominal(limits.springs, BuiltParameters().with_hubs())
    return NominalRobots(
        design.morphology,
        robot,
        design.ballast / 2,
        design.printed_terrain,
        limits.tolerances,
        power_shares=limits.power_shares,
    )


def identified_robots(
    design: Design, limits: HeatingLimits, scene: PrintedScene, filmed: Sequence[FilmedGait] = ()
) -> RobotDistribution:
    """Robots of a design around the one that was identified from films, on the rig's supply. `filmed`: gaits
    in which its samples stay upright as that one does."""
    robots = IdentifiedRobots.of(design, scene, [film.gait for film in filmed])
    return replace(robots, power_shares=limits.power_shares)
