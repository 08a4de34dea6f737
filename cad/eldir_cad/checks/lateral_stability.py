"""Whether a robot falls over sideways if its faces are not heated alike: lean and tipping margin in degrees.

The lean is that of `eldir_cad.checks.lean` in the motion of the nominal robot. Its faces differ by the
current: `CURRENT_SPREAD` more in front, as much less behind. Friction in the sockets has not been measured,
and shocks overcome it. So the margin is that without friction, on a table that slopes sideways.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir.built.gait import Gait, heat_faces
from eldir.built.motion import OK, drive
from eldir.built.robot import build
from eldir.core.records import FloatArray, Record, record
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.wiring import FACES
from eldir_cad.checks.lean import CoilTable, Condition, Frame, Lean, predict_lean
from eldir_cad.checks.strip_law import hub_parameters
from eldir_cad.checks.tipping import CURRENT_SPREAD, REQUIRED_MARGIN_DEG, lateral_section
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification

SIDE_TILT = math.radians(0.5)
"""Slope of the table to either side for which the margin holds [rad]."""
_EVERY = 20  # rows of free lengths between poses: one second
_RESTED = 3  # seconds until a robot has settled on the table


@record
class LateralStability(Record):
    """How far a robot leans whose faces differ by the stated spread, and how far it is from falling."""

    lean_deg: Annotated[float, Field(ge=0, le=90)]
    """Largest lean to either side [degrees]; 90: it falls over."""
    tipping_deg: Annotated[float, Field(ge=0, le=90)]
    """Smallest lean in the motion at which it would tip [degrees]."""
    margin_deg: float
    """Smallest difference of both if nothing holds strips in their sockets and the table slopes sideways by
    half a degree [degrees]; negative: it falls over."""

    @property
    def is_safe(self) -> bool:
        """Whether the margin is at least `REQUIRED_MARGIN_DEG`."""
        return self.margin_deg >= REQUIRED_MARGIN_DEG

    def __str__(self) -> str:
        if self.margin_deg < 0:
            return f"it may fall over sideways (tips at {self.tipping_deg:.0f} degrees)"
        leans = f"leans sideways by {self.lean_deg:.0f} of {self.tipping_deg:.0f} degrees"
        return leans if self.is_safe else f"{leans}, margin only {self.margin_deg:.0f}"


def spread_current(springs: SpringParameters, motors: int, spread: float) -> list[SpringParameters]:
    """Springs of both faces as `eldir.built.gait.heat_faces` takes them; the current is higher in front and
    lower behind by this part."""
    faces = [replace(springs, current_limit=springs.current_limit * (1 + part)) for part in (spread, -spread)]
    return faces * motors


def predict_lateral_stability(
    morphology: Morphology,
    gait: Gait,
    spec: Specification,
    printer: Printer,
    springs: SpringParameters,
    *,
    ballast: FloatArray | float = 0.0,
    cycles: int = 1,
) -> LateralStability | None:
    """Lateral stability of a design's nominal robot in its gait, on a table, with faces that differ by
    `CURRENT_SPREAD`. `ballast` of one plane [kg], as `eldir.built.robot.build` takes it; `cycles` after one
    of conditioning.

    None where it says nothing: for clamped strips, which the model does not know, and for a robot that does
    not survive in its plane.
    """
    both = spread_current(springs, morphology.motors, CURRENT_SPREAD)
    robot = RobotParameters(hub_parameters(spec, printer, springs), springs)
    if robot.printed.joints != "hubs":
        return None
    leans = lean_in_gait(morphology, gait, robot, both, spec, printer, ballast=ballast, cycles=cycles)
    return None if leans is None else summarise(leans)


def summarise(leans: Sequence[Lean]) -> LateralStability:
    """From the cases of `lean_in_gait`: with friction, and without it on slopes to both sides."""
    with_friction = leans[0]
    margin = min(np.degrees(lean.margin) for lean in leans)
    return LateralStability(
        round(float(np.degrees(with_friction.max_roll)), 2),
        round(float(np.degrees(with_friction.tipping.min())), 2),
        round(float(max(margin, -90.0)), 2),
    )


def lean_in_gait(
    morphology: Morphology,
    gait: Gait,
    robot: RobotParameters,
    springs: Sequence[SpringParameters],
    spec: Specification,
    printer: Printer,
    *,
    ballast: FloatArray | float = 0.0,
    cycles: int = 1,
) -> list[Lean] | None:
    """Lean of a robot with hubs in its gait: with the friction of its sockets, and without it on slopes to
    both sides. `springs`: front and back one of the first motor, front and back one of the second. None if it
    does not survive in its plane."""
    table = heat_faces(gait, springs, cycles, morphology.motor_hubs)
    lengths = table.lengths.reshape(len(table.lengths), -1, len(FACES))
    one_plane = build(morphology, robot, ballast=ballast).coarse()
    free = robot.springs.cold_length, robot.springs.hot_length
    (motion,) = drive([one_plane], [lengths.mean(axis=2)], table.interval, every=_EVERY, free=free)
    if motion.status != OK:
        return None
    shown = lengths[::_EVERY][_RESTED:]
    hot = np.clip((shown - free[0]) / (free[1] - free[0]), 0.0, 1.0)
    coils = CoilTable(shown, robot.springs.stiffness(1.0 - hot))
    frame = Frame(
        morphology.springs,
        morphology.active,
        len(FACES) * build(morphology, robot, ballast=ballast).masses,
        lateral_section(spec, printer, robot.printed),
    )
    friction = robot.printed.socket_friction
    conditions = [Condition(friction), Condition(0.0, SIDE_TILT), Condition(0.0, -SIDE_TILT)]
    return predict_lean(frame, motion.positions[_RESTED:], coils, conditions)
