"""Falls by the marks alone, against where the whole body truly is: figures of docs/reference/dynamics.md."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.gait import Gait, free_lengths_batch
from eldir.built.motion import OK, drive
from eldir.built.robot import PrintedRobot, build, find_shape_fault, static_margin
from eldir.built.screening import MARGIN, candidate_gaits
from eldir.built.walking import TOPPLED_ANGLE, rotation
from eldir.design import marked_masses
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.trajectory import Trajectory
from eldir_calibration.dynamics.recording import find_fall

pytestmark = pytest.mark.stress
BODIES, CYCLES = 40, 3
SOFT = replace(BuiltParameters(), tension=20e3)


def standing() -> list[tuple[Morphology, PrintedRobot]]:
    """Random bodies of two motors that keep their shape, with three marks or more."""
    rng, lattice = np.random.default_rng(5), Lattice(6, 11)
    found: list[tuple[Morphology, PrintedRobot]] = []
    while len(found) < BODIES:
        for genotype in random_genotypes(lattice, BODIES, rng, 2):
            body = develop(lattice, genotype)
            if body.motors != 2 or len(marked_masses(body)) < 3:
                continue
            robot = build(body, SOFT)
            if static_margin(robot) > MARGIN and not find_shape_fault(robot):
                found.append((body, robot))
    return found[:BODIES]


@pytest.mark.parametrize("stroke", [1.0, 1.5])
def test_marks_tell_most_falls_and_invent_none(stroke: float) -> None:
    """Also where the springs move half as far again as the kit's, and turn a limb with a marker by 90
    degrees."""
    kit, gaits = SpringParameters(), candidate_gaits(2)[::2]
    springs = replace(kit, hot_length=kit.cold_length + stroke * (kit.hot_length - kit.cold_length))
    every: list[tuple[Morphology, PrintedRobot, Gait]] = [(b, r, g) for b, r in standing() for g in gaits]
    tables = free_lengths_batch([(g, [springs, springs]) for _, _, g in every], CYCLES)
    free = (springs.cold_length, springs.hot_length)
    motions = drive([r for _, r, _ in every], [t.lengths for t in tables], 0.05, every=4, free=free)
    fell, told = [], []
    for (body, robot, _), motion in zip(every, motions, strict=True):
        if motion.status != OK:
            continue
        marks = marked_masses(body)
        names = tuple(f"m{i + 1}" for i in range(len(marks)))
        fell.append(bool(np.abs(rotation(robot.positions, motion.positions)).max() > TOPPLED_ANGLE))
        path = Trajectory(names, motion.times, motion.positions[:, marks])
        told.append(find_fall(robot.positions[marks], path) is not None)
    right = sum(f and t for f, t in zip(fell, told, strict=True))
    print(f"{len(fell)} runs: {sum(fell)} falls, {right} told by the marks, {sum(told) - right} invented")
    assert sum(told) == right and right >= 0.7 * sum(fell)
