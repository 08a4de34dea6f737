"""From a design to a schedule for a rig: phases searched or imitated, motion predicted for both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from eldir import __version__
from eldir.built.ensembles import Ensemble, as_found, ensemble, ensembles
from eldir.built.filmed_gait import SeenGait
from eldir.built.gait import CYCLES, Gait, heated
from eldir.built.gait_choice import choose
from eldir.built.robot import build
from eldir.built.scene import BuiltScene
from eldir.built.screening import candidate_gaits, displacements
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.rollout import simulate
from hardware.planning.compiler import compile_schedule
from hardware.planning.heat_preview import foresee
from hardware.planning.timing import own_timing
from hardware.rig.configuration import Rig
from hardware.rig.supply import LimitError
from hardware.schedule import ActuationSchedule
from hardware.schedule_prediction import SchedulePrediction

_BUILDS = 8  # robots that try each period and duty
_LONGER, _SHORTER = 1.25, 0.85


def plan(
    design: Design,
    rig: Rig,
    *,
    imitate: bool = False,
    seed: int = 0,
    builds: int = 16,
    design_file: str = "design.json",
    scene: BuiltScene | None = None,
) -> ActuationSchedule:
    """The design's schedule on this rig, with what is predicted of it; the same seed, the same bytes.

    With a `scene` that films gave, gaits are searched over robots drawn from it, and predicted for them;
    one that the camera saw walking is kept unless another is better beyond doubt (`eldir.built.gait_choice`).
    The rig file alone still says what is safe.

    `builds`: robots in the ensemble of either method. `design_file`: path from the schedule to the
    design; by it a virtual rig knows which robot to move.
    """
    motors = design.morphology.motors
    if motors > rig.motors:
        raise InputError(
            "the design has more active springs than the rig can heat",
            expected=f"at most {rig.motors}",
            found=str(motors),
            remedy="evolve with --max-motors, or add channels to the rig file",
        )
    seen = [] if scene is None else [s for s in scene.seen_of(design) if _allowed(s.gait, rig)]
    if scene is None:
        searched = searched_gait(design, rig, seed)
    else:
        searched = robust_gait(design, rig, scene, seen, seed)
    gaits = {"search": searched, "imitate": imitated_gait(design)}
    walks = {name: _walks(design, gait, rig, seed, builds, scene, seen) for name, gait in gaits.items()}
    told = {name: _told(gait, walks[name]) for name, gait in gaits.items()}
    method, choice = "imitate" if imitate else "search", {}
    if scene is not None and not imitate:
        chosen = choose(design, searched, walks["search"], seen, scene)
        choice = {"choice": chosen.told}
        if chosen.kept is not None:
            method, gaits["seen"] = "seen", chosen.gait
            again = _walks(design, chosen.gait, rig, seed, builds, scene, seen)
            told["seen"] = _told(chosen.gait, again) | {"seen": round(chosen.kept.walked, 6)}
    schedule = compile_schedule(
        gaits[method],
        rig,
        tuple(int(s) for s in np.flatnonzero(design.morphology.active)),
        CYCLES,
        {"eldir": __version__, "seed": seed, "rig": rig.name, "design": design_file},
    )
    more = {"method": method, "displacement": told, "cycle": foresee(schedule, rig)} | choice
    return replace(schedule, predicted=SchedulePrediction.from_json(schedule.predicted.to_json() | more))


def searched_gait(design: Design, rig: Rig, seed: int = 0) -> Gait:
    """Phases that carry the nominal built robot farthest forward within the rig's limits, and of some periods
    and duties those that carry an ensemble farthest, where a build that falls counts as none.

    All relative phases are tried at the usual period and duty; the best of them again at the springs'
    own timing, with longer pauses and with shorter heating.
    """
    springs = rig.spring_parameters()
    best = _farthest(design, _phases(design.morphology.motors, rig), springs)
    tried = [best, *_retimed(best, rig, springs)]

    def expected(gait: Gait) -> float:
        # Other builds than those for which the walk is then predicted.
        ballast = design.ballast / 2
        builds = ensemble(design.morphology, gait, _BUILDS, seed + 1, springs=springs, ballast=ballast)
        return builds.expected

    return max(tried, key=expected)


def robust_gait(
    design: Design, rig: Rig, scene: BuiltScene, seen: Sequence[SeenGait] = (), seed: int = 0
) -> Gait:
    """Phases, and then period and duty, that carry robots drawn from the scene farthest forward, in the mean.

    What the most probable robot itself does not walk, those drawn around it cannot promise. Gaits that were
    `seen` are left out: of them the camera tells more.
    """
    parts, ballast = scene.parts_of(design), design.ballast / 2
    filmed = [s.gait for s in seen]

    def judged(gaits: list[Gait]) -> list[_Judged]:
        # Other draws than those for which the walk is then predicted.
        body = design.morphology
        drawn = ensembles(
            body, gaits, _BUILDS, seed + 1, ballast=ballast, scene=scene, parts=parts, filmed=filmed
        )
        itself = as_found(body, gaits, scene, parts, ballast).tolist()
        every = zip(drawn, itself, gaits, strict=True)
        return [_Judged(min(walks.expected, one), walks.expected, gait) for walks, one, gait in every]

    tried = judged(_phases(design.morphology.motors, rig))
    best = max(tried, key=_Judged.worth)
    if others := _retimed(best.gait, rig, scene.springs):
        tried += judged(others)
    unseen = [one for one in tried if not any(s.is_of(one.gait) for s in seen)]
    return max(unseen or tried, key=_Judged.worth).gait


class _Judged(NamedTuple):
    """A gait with the walk that is expected of it."""

    promised: float
    """By the most probable robot and by those drawn around it: the less of both."""
    drawn: float
    """By those alone."""
    gait: Gait

    def worth(self) -> tuple[float, float]:
        """Where the most probable robot falls with all gaits, those drawn decide."""
        return self.promised, self.drawn


def _phases(motors: int, rig: Rig) -> list[Gait]:
    """All relative phases that the rig allows at the usual period and duty, or else at its springs' own
    timing; where it allows none, all of them."""
    usual = candidate_gaits(motors)
    if allowed := [g for g in usual if _allowed(g, rig)]:
        return allowed
    period, duty = own_timing(rig.spring_parameters(), rig, motors)
    slower = [replace(g, period=period, duty=np.full(motors, duty)) for g in usual]
    return [g for g in slower if _allowed(g, rig)] or slower


def _retimed(gait: Gait, rig: Rig, springs: SpringParameters) -> list[Gait]:
    """The same phases at the own timing of such springs, with longer pauses and with shorter heating, as far
    as the rig allows."""
    motors = len(gait.phase)
    period, duty = own_timing(springs, rig, motors)
    times = [
        (period, duty),
        (round(_LONGER * period, 1), duty / _LONGER),
        (gait.period, _SHORTER * gait.duty[0]),
    ]
    others = [replace(gait, period=p, duty=np.full(motors, d)) for p, d in times]
    return [g for g in others if _allowed(g, rig)]


def _farthest(design: Design, gaits: list[Gait], springs: SpringParameters) -> Gait:
    """Of the nominal built robot."""
    robot = build(design.morphology, BuiltParameters())
    tables = heated([(gait, [springs] * design.morphology.motors) for gait in gaits])
    walks = displacements([robot] * len(gaits), tables, CYCLES, (springs.cold_length, springs.hot_length))
    return gaits[int(np.argmax(walks))]


def _allowed(gait: Gait, rig: Rig) -> bool:
    try:
        compile_schedule(gait, rig)
    except LimitError:
        return False
    return True


def imitated_gait(design: Design) -> Gait:
    """The closed loop's own phases."""
    (rollout,) = simulate([design.morphology], [design.controller], design.scene)
    return Gait.from_rollout(rollout, design.scene)


def _walks(
    design: Design,
    gait: Gait,
    rig: Rig,
    seed: int,
    count: int,
    scene: BuiltScene | None,
    seen: Sequence[SeenGait] = (),
) -> Ensemble:
    """Of builds around the nominal robot, or of robots drawn from a scene that do what was `seen`."""
    return ensemble(
        design.morphology,
        gait,
        count,
        seed,
        springs=rig.spring_parameters(),
        ballast=design.ballast / 2,
        scene=scene,
        parts=None if scene is None else scene.parts_of(design),
        filmed=[s.gait for s in seen],
    )


def _told(gait: Gait, builds: Ensemble) -> dict[str, Any]:
    """Body lengths per five cycles over an ensemble of builds: mean and spread of those that stand, null
    where all fall over; forward is counted among all."""
    stands = bool(np.isfinite(builds.mean))
    return {
        "period_s": round(gait.period, 6),
        "phase": [round(float(x), 6) for x in gait.phase],
        "duty": [round(float(x), 6) for x in gait.duty],
        "builds": len(builds.displacement),
        "fell": int(np.isinf(builds.displacement).sum()),
        "mean": round(builds.mean, 6) if stands else None,
        "spread": round(builds.spread, 6) if stands else None,
        "probability_forward": builds.probability_forward,
    }
