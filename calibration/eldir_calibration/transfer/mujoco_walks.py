"""Walks of robots in MuJoCo, measured as `eldir.built.walking` measures its own robots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Event
from typing import Literal

import numpy as np

from eldir.built.gait import CYCLES, FreeLengths, Gait, heat_faces
from eldir.built.robot import build, min_area_ratio
from eldir.built.walking import FOLDED_AREA_RATIO, TOPPLED_ANGLE, rotation
from eldir.core.records import FloatArray, IntArray
from eldir.design import Design
from eldir.errors import EldirError
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir.parameters.wiring import FACES
from eldir_cad.kit import PRINTER
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.model import Multibody, Numerics, build_multibody
from eldir_hardware.virtual.mujoco_body import CoilDrivenMotion, MujocoMotion, sample_multibody

FINE_NUMERICS = Numerics(step=1e-4, contact_time=2e-4)
"""Three times as fine as on the virtual rig: walks of small robots change by up to a third between both, and
by 0.02 beyond this (docs/reference/second-physics-measured.md)."""
SAMPLE_ROWS = 20
"""Rows of free lengths between positions that are kept: one second."""


WalkFault = Literal["", "turns over", "falls sideways", "folds", "buckles a coil", "fails"]


@dataclass(frozen=True)
class MujocoWalk:
    """How far a robot walks in MuJoCo."""

    displacement: float
    """[Body lengths per five cycles]; minus infinity where it falls, in the sense of `fault`."""
    fault: WalkFault = ""
    """Why it does not count as a walk: "turns over" or "falls sideways" (by 45 degrees, the latter in three
    dimensions), "folds" (a triangle), "buckles a coil", or "fails" (the simulation); empty if it walks."""


def walk_sampled_robot(
    design: Design,
    gait: Gait,
    seed: int,
    springs: SpringParameters,
    tolerances: RigTolerances,
    cycles: int,
    cancelled: Event | None = None,
) -> MujocoWalk:
    """Walk of the robot that a seed gives the virtual rig.

    Robot, feet, slope of the table, all springs together and each by itself deviate by the seed from the
    nominal `springs`. `cycles` are counted, after one that is not. Once `cancelled` is set it gives up.
    """
    ground = design.printed_terrain
    sample = sample_multibody(design.morphology, seed, design.ballast, terrain=ground, springs=springs)
    model = replace(sample, numerics=FINE_NUMERICS)
    on_rig = tolerances.perturb_by_seed(springs, seed)
    heating = sample_heating(gait, seed, on_rig, cycles, design.morphology.motor_hubs, tolerances)
    return measure_walk(model, design.morphology, heating, cycles, springs, cancelled)


def walk_given_robot(
    morphology: Morphology, robot: RobotParameters, table: FreeLengths, cycles: int
) -> float:
    """Walk of a robot with these parameters under prescribed free lengths, in the time steps of the virtual
    rig [body lengths per five cycles]; minus infinity where it falls."""
    model = build_multibody(
        morphology,
        load_specification(),
        load_printer(PRINTER),
        robot.printed,
        strip_extensions=robot.strips if len(robot.strips) else None,
        friction_factors=robot.feet if len(robot.feet) else None,
    )
    return measure_walk(model, morphology, table, cycles, robot.springs).displacement


def sample_heating(
    gait: Gait,
    seed: int,
    springs: SpringParameters,
    cycles: int,
    hubs: IntArray | None = None,
    tolerances: RigTolerances | None = None,
) -> FreeLengths:
    """Free lengths of motors whose springs, one on each face, deviate by the seed; a motor follows their
    mean. `hubs` of each motor: heat passes between springs of one face."""
    motors = len(gait.phase)
    table = heat_faces(gait, sample_face_springs(motors, seed, springs, tolerances), cycles, hubs)
    return replace(table, lengths=table.lengths.reshape(-1, motors, len(FACES)).mean(axis=2))


def sample_face_springs(
    motors: int,
    seed: int,
    springs: SpringParameters,
    tolerances: RigTolerances | None = None,
) -> list[SpringParameters]:
    """The springs that a seed gives both faces, in the order of `eldir.built.gait.heat_faces`.
    `tolerances` of their rig: by default those of a new rig file."""
    deviations, allowed = np.random.default_rng([seed, 3]), tolerances or RigTolerances()
    return [allowed.perturb_one(springs, deviations) for _ in range(len(FACES) * motors)]


def measure_walk(
    model: Multibody,
    morphology: Morphology,
    table: FreeLengths,
    cycles: int,
    springs: SpringParameters,
    cancelled: Event | None = None,
) -> MujocoWalk:
    """Walk of a model of this body under prescribed free lengths. Raises `MissingDependencyError` without
    MuJoCo."""
    free = springs.cold_length, springs.hot_length
    motion = MujocoMotion(model, free)
    positions: list[FloatArray] = []
    try:
        loads = follow_table(motion, table, springs, lambda: positions.append(motion.positions), cancelled)
    except EldirError:
        return MujocoWalk(-np.inf, "fails")
    return evaluate_walk(morphology, np.array(positions), loads, table, cycles)


def follow_table(
    motion: CoilDrivenMotion,
    table: FreeLengths,
    springs: SpringParameters,
    on_second: Callable[[], None],
    cancelled: Event | None = None,
) -> FloatArray:
    """Drive a robot by free lengths of its coils. Returns the shortening of each coil over the one at which
    it buckles, after each second: shape (T, A). `springs`: the size of the coils.

    `on_second` is called at the beginning and after each second. Raises `EldirError` where the simulation
    fails, and once `cancelled` is set.
    """
    on_second()
    loads = []
    for row in range(0, len(table.lengths) - SAMPLE_ROWS, SAMPLE_ROWS):
        if cancelled is not None and cancelled.is_set():
            raise EldirError("the simulation was cancelled")
        motion.follow(table.lengths[row : row + SAMPLE_ROWS + 1], table.interval)
        on_second()
        loads.append(motion.coil_loads(table.lengths[row + SAMPLE_ROWS], springs))
    return np.array(loads)


def evaluate_walk(
    morphology: Morphology, positions: FloatArray, loads: FloatArray, table: FreeLengths, cycles: int
) -> MujocoWalk:
    """`positions` [m] every `SAMPLE_ROWS` rows of the table, shape (T + 1, M, 2); `loads`: shortening of
    each coil over the one at which it buckles, in all of them but the first, shape (T, A)."""
    robot = build(morphology)
    if np.abs(rotation(robot.positions, positions)).max() > TOPPLED_ANGLE:
        return MujocoWalk(-np.inf, "turns over")
    # Hubs may touch each other: MuJoCo knows their contact.
    if min_area_ratio(robot, positions) < FOLDED_AREA_RATIO:
        return MujocoWalk(-np.inf, "folds")
    if (loads > 1.0).any():
        return MujocoWalk(-np.inf, "buckles a coil")
    forward = positions[-1, :, 0].mean() - positions[table.first_cycle // SAMPLE_ROWS, :, 0].mean()
    return MujocoWalk(float(forward / robot.body_length * CYCLES / cycles))
