"""From a design to a schedule for a rig: phases searched or imitated, motion predicted for both."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from eldir import __version__
from eldir.built import BuiltParameters, build
from eldir.design import Design
from eldir.errors import InputError
from eldir.gait import CYCLES, Gait, free_lengths
from eldir.rollout import simulate
from eldir.screening import candidate_gaits, displacements, ensemble
from eldir.sma import SpringParameters
from hardware.compiler import compile_schedule
from hardware.rig import Rig
from hardware.schedule import ActuationSchedule


def plan(
    design: Design,
    rig: Rig,
    *,
    imitate: bool = False,
    seed: int = 0,
    builds: int = 16,
    design_file: str = "design.json",
) -> ActuationSchedule:
    """The design's schedule on this rig, with what is predicted of it; the same seed, the same bytes.

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
    gaits = {"search": searched_gait(design, springs), "imitate": imitated_gait(design)}
    method = "imitate" if imitate else "search"
    schedule = compile_schedule(
        gaits[method],
        rig,
        tuple(int(s) for s in np.flatnonzero(design.morphology.active)),
        CYCLES,
        {"eldir": __version__, "seed": seed, "rig": rig.name, "design": design_file},
    )
    walks = {name: _walk(design, gait, springs, seed, builds) for name, gait in gaits.items()}
    return replace(schedule, predicted=schedule.predicted | {"method": method, "displacement": walks})


def searched_gait(design: Design, springs: SpringParameters) -> Gait:
    """The relative phases that carry the nominal built robot farthest forward."""
    body = design.morphology
    gaits = candidate_gaits(body.motors)
    robot = build(body, BuiltParameters())
    tables = [free_lengths(gait, springs) for gait in gaits]
    walks = displacements([robot] * len(gaits), tables, CYCLES, springs)
    return gaits[int(walks.argmax())]


def imitated_gait(design: Design) -> Gait:
    """The closed loop's own phases."""
    (rollout,) = simulate([design.morphology], [design.controller], design.scene)
    return Gait.from_rollout(rollout, design.scene)


def _walk(design: Design, gait: Gait, springs: SpringParameters, seed: int, count: int) -> dict[str, Any]:
    """Body lengths per five cycles over an ensemble of builds; null where all fall over."""
    builds = ensemble(design.morphology, gait, count, seed, springs=springs, ballast=design.ballast / 2)
    stands = bool(np.isfinite(builds.mean))
    return {
        "phase": [round(float(x), 6) for x in gait.phase],
        "duty": [round(float(x), 6) for x in gait.duty],
        "builds": len(builds.displacement),
        "fallen": round(builds.fallen, 6),
        "mean": round(builds.mean, 6) if stands else None,
        "spread": round(builds.spread, 6) if stands else None,
        "probability_forward": builds.probability_forward,
    }
