"""Walks of robots in MuJoCo with their two faces apart: how far, and how much they turn and lean."""

from __future__ import annotations

from dataclasses import dataclass, replace
from threading import Event

import numpy as np

from eldir.built.gait import CYCLES, FreeLengths, Gait, heat_faces
from eldir.built.walking import TOPPLED_ANGLE
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.errors import EldirError
from eldir.morphology import Morphology
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_cad.multibody.biplane import Biplane
from eldir_calibration.transfer.mujoco_walks import (
    FINE_NUMERICS,
    SAMPLE_ROWS,
    MujocoWalk,
    evaluate_walk,
    follow_table,
    sample_face_springs,
)
from eldir_hardware.virtual.biplane_body import BiplaneMotion, sample_biplane


@dataclass(frozen=True)
class BiplaneWalk(MujocoWalk):
    """A walk, and how the robot leaves its plane."""

    yaw: float = np.nan
    """Rotation about the vertical, positive to the back of the robot's first direction [rad per five
    cycles]; NaN where the simulation fails."""
    roll: float = np.nan
    """Largest lean to either side [rad]."""
    drift: float = np.nan
    """Motion to the back [body lengths per five cycles]."""


def walk_sampled_biplane(
    design: Design,
    gait: Gait,
    seed: int,
    springs: SpringParameters,
    tolerances: RigTolerances,
    cycles: int,
    cancelled: Event | None = None,
) -> BiplaneWalk:
    """Walk of the robot that a seed gives, with strips, feet and springs of each face. Arguments as of
    `walk_sampled_robot`; springs, and what all of them have in common, are those that it has the means of."""
    ground = design.printed_terrain
    sample = sample_biplane(design.morphology, seed, design.ballast, terrain=ground, springs=springs)
    model = replace(sample, plane=replace(sample.plane, numerics=FINE_NUMERICS))
    on_rig = tolerances.perturb_by_seed(springs, seed)
    own = sample_face_springs(len(gait.phase), seed, on_rig, tolerances)
    table = heat_faces(gait, own, cycles, design.morphology.motor_hubs)
    return measure_biplane_walk(model, design.morphology, table, cycles, springs, cancelled)


def measure_biplane_walk(
    model: Biplane,
    morphology: Morphology,
    table: FreeLengths,
    cycles: int,
    springs: SpringParameters,
    cancelled: Event | None = None,
) -> BiplaneWalk:
    """Walk of a model under free lengths of each coil, in the order of `heat_faces`. Raises
    `MissingDependencyError` without MuJoCo."""
    motion = BiplaneMotion(model, (springs.cold_length, springs.hot_length))
    seen: list[FloatArray] = []
    try:
        loads = follow_table(motion, table, springs, lambda: seen.append(motion.discs), cancelled)
    except EldirError:
        return BiplaneWalk(-np.inf, "fails")
    discs = np.array(seen)
    centres = discs.mean(axis=2)
    found = evaluate_walk(morphology, centres[..., [0, 2]], loads, table, cycles)
    yaws, rolls = yaw_and_roll(discs[0].reshape(-1, 3), discs.reshape(len(discs), -1, 3))
    roll, first = float(np.abs(rolls).max()), table.first_cycle // SAMPLE_ROWS
    if roll > TOPPLED_ANGLE:
        found = MujocoWalk(-np.inf, "falls sideways")
    yaw = float(np.unwrap(yaws[first:])[-1] - yaws[first]) * CYCLES / cycles
    aside = float(centres[-1, :, 1].mean() - centres[first, :, 1].mean()) * CYCLES / cycles
    length = float(np.ptp(centres[0, :, 0]))
    return BiplaneWalk(found.displacement, found.fault, yaw, roll, aside / length)


def yaw_and_roll(rest: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation of a body as a whole about the vertical, and its lean about its own direction of travel [rad],
    shape (T,) each.

    From the rotation that fits best in the least squares' sense (Kabsch: Acta Cryst. A32 (1976) 922). `rest`:
    points of the body in its first pose [m], shape (P, 3); `points`: the same as it moves, shape (T, P, 3).
    """
    a = rest - rest.mean(axis=0)
    b = points - points.mean(axis=1, keepdims=True)
    u, _, vt = np.linalg.svd(b.swapaxes(1, 2) @ a)
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    turned = u @ vt
    # The body's y axis stays level under yaw and pitch.
    return np.arctan2(-turned[:, 0, 1], turned[:, 1, 1]), np.arcsin(np.clip(turned[:, 2, 1], -1, 1))
