"""From a design to a schedule for a rig, with the motion predicted for it.

The rig gives the limits, `eldir.built.gait_search` finds the gait, the compiler makes the schedule.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from eldir.built.gait import CYCLES, Gait
from eldir.built.gait_search import FoundGaits, HeatingLimits, Stage, find_gait, silent
from eldir.built.heat import HeatModel, SpringState
from eldir.built.samples import SampledWalks
from eldir.built.scene import BuiltScene
from eldir.built.screening import candidate_gaits
from eldir.core.version import __version__
from eldir.design import Design
from eldir.parameters.springs import SpringParameters
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.heat_preview import predicted_cycle
from eldir_hardware.planning.timing import own_timing
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.margins import heat_margins
from eldir_hardware.safety.schedule_digests import with_digests
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.schedule_prediction import PredictedWalk

MAX_PERIOD_S = 120.0
"""Longest period of a gait that is searched [s]."""


def plan(
    design: Design,
    rig: Rig,
    *,
    imitate: bool = False,
    seed: int = 0,
    samples: int = 16,
    cycles: int = CYCLES,
    design_file: str = "design.json",
    scene: BuiltScene | None = None,
    stage: Stage = silent,
) -> ActuationSchedule:
    """The schedule of a design on this rig, with its predicted walk; the same seed gives the same bytes.

    With a `scene` from films, gaits are searched and predicted for robots sampled from it. A filmed gait that
    walked is kept unless another one is better by the required margin (`eldir.built.gait_choice`). Limits of
    heat come from the rig file alone.

    `samples`: number of robots for which each walk is predicted, over five cycles. `cycles`: those of the
    schedule that count. `design_file`: path from the schedule to the
    design, from which a virtual rig loads its robot. `stage` is called with what is computed next. Raises
    `InputError` if the design has more motors than the rig can heat, `LimitError` if no gait keeps the limits
    of the rig.
    """
    motors = design.morphology.motors
    rig.require_motors(motors)
    limits = heating_limits(rig)
    _require_quick_springs(limits, motors)
    found = find_gait(design, limits, imitate=imitate, seed=seed, samples=samples, scene=scene, stage=stage)
    schedule = compile_schedule(
        found.gait,
        rig,
        tuple(int(s) for s in np.flatnonzero(design.morphology.active)),
        cycles,
        {"eldir": __version__, "seed": seed, "rig": rig.name, "design": design_file},
    )
    predicted = replace(
        schedule.predicted,
        method=found.method,
        displacement=_displacements(found),
        cycle=predicted_cycle(schedule, rig),
        choice=found.reason or None,
        margins=heat_margins(schedule, rig),
    )
    return with_digests(replace(schedule, predicted=predicted), rig, design, scene)


def heating_limits(rig: Rig) -> HeatingLimits:
    """The limits within which gaits are searched for this rig."""

    def allowed(gait: Gait) -> bool:
        if gait.period > MAX_PERIOD_S:
            return False
        try:
            compile_schedule(gait, rig)
        except LimitError:
            return False
        return True

    @cache
    def timing(springs: SpringParameters, motors: int) -> tuple[float, float]:
        return own_timing(springs, rig, motors)

    return HeatingLimits(rig.spring_parameters(), allowed, timing)


def _require_quick_springs(limits: HeatingLimits, motors: int) -> None:
    """Raise `LimitError` where springs need more than `MAX_PERIOD_S` to cool and the usual period is not
    allowed: simulating every gait would take hours."""
    springs = limits.springs
    hot = SpringState(np.array([springs.austenite_finish]), np.zeros(1))
    goal = max(springs.martensite_finish - springs.ambient, 0.5)
    period = float(HeatModel([springs]).cooling_time(hot, goal)[0])
    if period > MAX_PERIOD_S and not limits.allowed(candidate_gaits(motors)[-1]):
        raise LimitError(
            "the springs cool too slowly for a gait",
            code="limit.slow-springs",
            expected=f"a period of at most {MAX_PERIOD_S:g} s",
            found=f"{period:.0f} s until they have cooled",
            remedy="add a fan (entry fan of the rig file), or take thinner wire",
        )


def _displacements(found: FoundGaits) -> dict[str, PredictedWalk]:
    """Every gait with its predicted walk, by method."""
    walks = {name: _predicted_walk(gait, found.walks[name]) for name, gait in found.gaits.items()}
    if found.kept is not None:
        walks["filmed"] = replace(walks["filmed"], filmed=round(found.kept.walked, 6))
    return walks


def _predicted_walk(gait: Gait, walks: SampledWalks) -> PredictedWalk:
    """A gait, and how far samples of the robot walk with it."""
    stands = bool(np.isfinite(walks.mean))
    return PredictedWalk(
        period_s=round(gait.period, 6),
        phase=tuple(round(float(x), 6) for x in gait.phase),
        duty=tuple(round(float(x), 6) for x in gait.duty),
        samples=len(walks.displacement),
        fell=int(np.isinf(walks.displacement).sum()),
        mean=round(walks.mean, 6) if stands else None,
        spread=round(walks.spread, 6) if stands else None,
        probability_forward=walks.probability_forward,
        tie_share=round(walks.tie_share, 6) if np.isfinite(walks.tie_share) else None,
    )
