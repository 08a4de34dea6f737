"""From a design to a schedule for a rig: phases searched or imitated, motion predicted for both."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from eldir import __version__
from eldir.built import build
from eldir.built_parameters import BuiltParameters
from eldir.built_scene import BuiltScene
from eldir.design import Design
from eldir.errors import InputError
from eldir.gait import CYCLES, Gait, free_lengths
from eldir.rollout import simulate
from eldir.screening import candidate_gaits, displacements, ensemble, ensembles
from eldir.sma_parameters import SpringParameters
from hardware.compiler import compile_schedule
from hardware.foresight import foresee
from hardware.rig import Rig
from hardware.schedule import ActuationSchedule
from hardware.supply import LimitError
from hardware.timing import own_timing

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

    With a `scene` that films gave, phases are searched over robots drawn from it, and predicted for them;
    the rig file alone still says what is safe.

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
    springs = rig.spring_parameters()
    searched = searched_gait(design, rig, seed) if scene is None else robust_gait(design, rig, scene, seed)
    gaits = {"search": searched, "imitate": imitated_gait(design)}
    method = "imitate" if imitate else "search"
    schedule = compile_schedule(
        gaits[method],
        rig,
        tuple(int(s) for s in np.flatnonzero(design.morphology.active)),
        CYCLES,
        {"eldir": __version__, "seed": seed, "rig": rig.name, "design": design_file},
    )
    walks = {name: _walk(design, gait, springs, seed, builds, scene) for name, gait in gaits.items()}
    more = {"method": method, "displacement": walks, "cycle": foresee(schedule, rig)}
    return replace(schedule, predicted=schedule.predicted | more)


def searched_gait(design: Design, rig: Rig, seed: int = 0) -> Gait:
    """Phases that carry the nominal built robot farthest forward within the rig's limits, and of some periods
    and duties those that carry an ensemble farthest, where a build that falls counts as none.

    All relative phases are tried at the usual period and duty; the best of them again at the springs'
    own timing, with longer pauses and with shorter heating.
    """
    springs, motors = rig.spring_parameters(), design.morphology.motors
    first = _best_first(design, candidate_gaits(motors), springs)
    period, duty = own_timing(springs, rig, motors)
    allowed = next((g for g in first if _allowed(g, rig)), None)
    if allowed is None:  # this rig's springs are not the usual ones
        slower = [replace(g, period=period, duty=np.full(motors, duty)) for g in first]
        allowed = next((g for g in _best_first(design, slower, springs) if _allowed(g, rig)), slower[0])
    times = [
        (period, duty),
        (round(_LONGER * period, 1), duty / _LONGER),
        (allowed.period, _SHORTER * allowed.duty[0]),
    ]
    others = [replace(allowed, period=p, duty=np.full(motors, d)) for p, d in times]
    tried = [allowed, *(g for g in others if _allowed(g, rig))]

    def expected(gait: Gait) -> float:
        # Other builds than those for which the walk is then predicted.
        ballast = design.ballast / 2
        builds = ensemble(design.morphology, gait, _BUILDS, seed + 1, springs=springs, ballast=ballast)
        return builds.expected

    return max(tried, key=expected)


def robust_gait(design: Design, rig: Rig, scene: BuiltScene, seed: int = 0, draws: int = 8) -> Gait:
    """The relative phases that carry robots drawn from the scene farthest forward, in the mean."""
    every = candidate_gaits(design.morphology.motors)
    gaits = [g for g in every if _allowed(g, rig)] or every
    # Other draws than those for which the walk is then predicted.
    ballast = design.ballast / 2
    tried = ensembles(design.morphology, gaits, draws, seed + 1, ballast=ballast, scene=scene)
    return gaits[int(np.argmax([walks.expected for walks in tried]))]


def _best_first(design: Design, gaits: list[Gait], springs: SpringParameters) -> list[Gait]:
    robot = build(design.morphology, BuiltParameters())
    free = (springs.cold_length, springs.hot_length)
    walks = [0.0] * len(gaits)
    for period in {g.period for g in gaits}:
        alike = [i for i, g in enumerate(gaits) if g.period == period]
        tables = [free_lengths(gaits[i], springs) for i in alike]
        found = displacements([robot] * len(alike), tables, CYCLES, free)
        for i, walk in zip(alike, found, strict=True):
            walks[i] = float(walk)
    return [gaits[i] for i in sorted(range(len(gaits)), key=lambda i: -walks[i])]


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


def _walk(
    design: Design, gait: Gait, springs: SpringParameters, seed: int, count: int, scene: BuiltScene | None
) -> dict[str, Any]:
    """Body lengths per five cycles over an ensemble of builds: mean and spread of those that stand, null
    where all fall over; forward is counted among all."""
    builds = ensemble(
        design.morphology, gait, count, seed, springs=springs, ballast=design.ballast / 2, scene=scene
    )
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
