"""Where a printed ground lies in the plane of motion.

Nothing measures it. It is put where a simulated robot stands on it as the filmed one does, a moment after the
start of a run; so only films that begin with a run have one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir_hardware.rig.configuration import Rig

SETTLED_S = 0.5
"""Time after the start of a run when the robot has settled; springs are hardly warm then [s]."""
_MAX_START_S = 1.0  # later it does not stand where the run began
_MAX_SPREAD = (
    0.005  # RMS of the markers' offsets from their mean; more is no robot that stands as simulated [m]
)
CORNER = BuiltParameters().with_hubs().corner
"""Height of a standing mass's centre over the ground [m]; pins, which have no size, stand as high."""
ON_GROUND = (
    "Where the ground lies is not measured: it is drawn where the prediction has it under the robot at the "
    "start."
)
"""Remark on a picture that shows the ground."""
NOT_DRAWN = (
    "The printed ground is not drawn: the markers were not tracked just after the start of a run, or the "
    "robot did not stand there as simulated."
)
"""Remark on a picture that does not, though the design has a terrain."""


@dataclass(frozen=True, eq=False)
class PrintedGround:
    """A simulated robot that stands on its ground."""

    markers: FloatArray
    """Its markers when it has settled [m], shape (K, 2)."""
    surface: FloatArray
    """Corners of the surface of the ground, x and height in the same coordinates [m], shape (P, 2)."""

    def in_plane(self, times: FloatArray, positions: FloatArray) -> FloatArray | None:
        """Corners of the surface in the plane of motion [m], shape (P, 2); None where `start_offset` knows
        nothing. `times` (T,) [s since the start], `positions` (T, K, 2) [m]: of the filmed markers."""
        offset = start_offset(times, positions, self.markers)
        return None if offset is None else self.surface + offset


def predict_ground(design: Design, rig: Rig | None = None) -> PrintedGround | None:
    """The ground of a design, and the nominal robot that stands on it, cold; None: a table. `rig`: that of
    the run. Takes a second."""
    terrain, body = design.printed_terrain, design.morphology
    if terrain is None:
        return None
    from eldir.built.ground import surface_line  # the engine takes a second to import
    from eldir.built.motion import drive
    from eldir.built.robot import build

    nominal = RobotParameters(BuiltParameters().with_hubs()) if rig is None else rig.nominal_robot()
    robot = build(body, nominal, ballast=design.ballast / 2)
    cold = [spring.cold_length for spring in nominal.motor_springs(body.motors)]
    (motion,) = drive(
        [robot], [np.tile(cold, (2, 1))], SETTLED_S, free=[nominal.free_lengths], terrain=terrain
    )
    surface = surface_line(terrain, robot.positions, CORNER)
    return PrintedGround(motion.positions[-1][design.marks], surface)


def start_offset(times: FloatArray, positions: FloatArray, markers: FloatArray) -> FloatArray | None:
    """From the simulated to the filmed markers when the robot has settled: forward and up [m], shape (2,).

    `times` (T,) [s since the start of the run], `positions` (T, K, 2) [m]: of the filmed markers, NaN where
    one was not tracked; `markers` (K, 2) [m]: of the simulated robot. None where no marker was tracked then,
    and where they stand otherwise than simulated.
    """
    for t, found in zip(times, positions, strict=True):
        offsets = found - markers[: len(found)]
        tracked = np.isfinite(offsets).all(axis=1)
        if not SETTLED_S - 1e-6 <= t <= _MAX_START_S or not tracked.any():
            continue
        mean = offsets[tracked].mean(axis=0)
        spread = np.sqrt(((offsets[tracked] - mean) ** 2).sum(axis=1).mean())
        return mean if spread <= _MAX_SPREAD else None
    return None
