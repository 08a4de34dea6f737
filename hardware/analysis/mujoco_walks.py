"""How far a robot walks in MuJoCo with a gait, measured as `eldir.built.walking` measures its own robots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cad.multibody.model import Multibody
from eldir.built.gait import CYCLES, FreeLengths, Gait, free_lengths
from eldir.built.robot import build
from eldir.built.statics import least_opening
from eldir.built.validity.coils import coil_load
from eldir.built.walking import FOLDED, TOPPLED, rotation
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.errors import EldirError
from eldir.morphology import Morphology
from eldir.parameters.springs import SpringParameters
from hardware.virtual.mujoco_body import MujocoMotion, drawn_multibody

_SAMPLE = 20  # rows of free lengths between positions kept: one second
_FACES = 2


def drawn_walk(design: Design, gait: Gait, seed: int, springs: SpringParameters, cycles: int) -> float:
    """Walk of the robot that a seed gives the virtual rig [body lengths per five cycles]; minus infinity
    where it falls.

    Robot, feet, slope of the table and each spring deviate by the seed. `springs`: their mean. `cycles` are
    counted, after one that is not.
    """
    model = drawn_multibody(design.morphology, seed, design.ballast)
    return measured_walk(
        model, design.morphology, drawn_heating(gait, seed, springs, cycles), cycles, springs
    )


def drawn_heating(gait: Gait, seed: int, springs: SpringParameters, cycles: int) -> FreeLengths:
    """Free lengths of motors whose springs, one on each face, deviate by the seed; a motor follows their
    mean."""
    deviations = np.random.default_rng([seed, 3])
    motors = len(gait.phase)
    own = [springs.perturbed(deviations) for _ in range(_FACES * motors)]
    both = Gait(gait.period, np.repeat(gait.phase, _FACES), np.repeat(gait.duty, _FACES))
    table = free_lengths(both, own, cycles)
    return replace(table, lengths=table.lengths.reshape(-1, motors, _FACES).mean(axis=2))


def measured_walk(
    model: Multibody, morphology: Morphology, table: FreeLengths, cycles: int, springs: SpringParameters
) -> float:
    """Walk of a model of this body under prescribed free lengths [body lengths per five cycles].

    Minus infinity where it rotates by more than 45 degrees, where a triangle folds, where a coil is
    compressed until it buckles, or where the simulation fails. Raises `MissingDependencyError` without
    MuJoCo.
    """
    motion = MujocoMotion(model, (springs.cold_length, springs.hot_length))
    positions = [motion.positions]
    for row in range(0, len(table.lengths) - _SAMPLE, _SAMPLE):
        try:
            motion.follow(table.lengths[row : row + _SAMPLE + 1], table.interval)
        except EldirError:
            return -np.inf
        positions.append(motion.positions)
    return _displacement(morphology, np.array(positions), table, cycles)


def _displacement(morphology: Morphology, positions: FloatArray, table: FreeLengths, cycles: int) -> float:
    """`positions` [m] every `_SAMPLE` rows of the table, shape (T, M, 2)."""
    robot = build(morphology)
    if np.abs(rotation(robot.positions, positions)).max() > TOPPLED:
        return -np.inf
    # Hubs may touch each other: MuJoCo knows their contact.
    if least_opening(robot, positions) < FOLDED:
        return -np.inf
    if coil_load(robot, positions, table.lengths[::_SAMPLE]).max(initial=0.0) > 1.0:
        return -np.inf
    forward = positions[-1, :, 0].mean() - positions[table.first_cycle // _SAMPLE, :, 0].mean()
    return float(forward / robot.body_length * CYCLES / cycles)
