"""Trials that evaluate printed robots: short ones with pins first, then hubs and new samples.

All robots are coarse (`PrintedRobot.coarse`), and one counted cycle tells enough to leave bad bodies out.
What decides is always the walk of samples with hubs that no choice was made with.
docs/reference/evolving-for-building.md has the error and the cost of each kind of trial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldir.built.gait import Gait, free_lengths_batch
from eldir.built.robot import build
from eldir.built.samples import NominalRobots
from eldir.built.walking import displacements
from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters
from eldir.parameters.tolerances import RigTolerances
from eldir.terrain import Terrain

LANES = 8
"""Robots of one body that the engine moves at the cost of one."""
FRESH = 8
"""New samples of one evaluation."""
_COMPARED_GAITS, _SAMPLES_EACH = 2, 4
_CYCLES = 1  # counted
_TILT = np.radians(2)  # either way [rad]
_MAX_COIL_LOAD = 0.75  # of the compression at which a coil buckles: more counts as buckling
_OFFSETS = (0.0, 0.06, -0.06, 0.125, -0.125, 0.25, -0.25, 0.5)
"""Changes of the motors' phases that the first trial tries, as fractions of the period."""


@dataclass(frozen=True)
class Trial:
    """One body with the gaits that are tried, and the seed of its samples."""

    body: Morphology
    gaits: tuple[Gait, ...]
    seed: tuple[int, ...]
    """Seed of the samples; the n-th sample of a robot is the same in every trial with this seed."""
    first: int = 0
    """Number of the first sample of a further evaluation."""
    terrain: Terrain | None = None
    """The ground, one for all trials of a run; by default a table."""


def make_screening_trial(
    body: Morphology, gait: Gait, seed: tuple[int, ...], spread: bool, terrain: Terrain | None = None
) -> Trial:
    """The first trial of a body: its gait and seven others around it, or with `spread` all eighths of the
    period. Motors after the first one move together, or against each other if there are three or more."""
    motors = len(gait.phase)
    steps = np.arange(LANES) / LANES if spread else np.array(_OFFSETS)
    turn = np.array([0.0, *(1.0 if m % 2 else -1.0 for m in range(1, motors))])
    gaits = [replace(gait, phase=(gait.phase + step * turn) % 1.0) for step in steps]
    return Trial(body, tuple(gaits), seed, terrain=terrain)


def screen_gaits(
    trials: Sequence[Trial], nominal: RobotParameters, tolerances: RigTolerances | None = None
) -> FloatArray:
    """Walks of one sample with each gait, one counted cycle, shape (trials, LANES). `tolerances` of the rig
    on which all samples walk, in all kinds of trials: by default those of a new rig file."""
    lanes = [(t, g, k) for t in trials for k, g in enumerate(t.gaits)]
    return _walks(lanes, nominal, tolerances).reshape(-1, LANES)


def compare_gaits(
    trials: Sequence[Trial], nominal: RobotParameters, tolerances: RigTolerances | None = None
) -> FloatArray:
    """Expected walks with each of two gaits: four samples with hubs, one counted cycle, shape (trials, 2)."""
    lanes = [(t, t.gaits[g], k) for t in trials for g in range(_COMPARED_GAITS) for k in range(_SAMPLES_EACH)]
    walks = _walks(lanes, _with_hubs(nominal), tolerances)
    return count_falls_as_zero(walks).reshape(-1, _COMPARED_GAITS, _SAMPLES_EACH).mean(axis=2)


def evaluate_walks(
    trials: Sequence[Trial], nominal: RobotParameters, tolerances: RigTolerances | None = None
) -> FloatArray:
    """Walks of eight samples from `first` on, each trial with its only gait, shape (trials, FRESH); a fall
    counts as no walk. The samples have hubs: pins promise walks that hubs do not keep."""
    lanes = [(t, t.gaits[0], t.first + k) for t in trials for k in range(FRESH)]
    return count_falls_as_zero(_walks(lanes, _with_hubs(nominal), tolerances)).reshape(-1, FRESH)


def walk_on_slopes(
    trials: Sequence[Trial], nominal: RobotParameters, tolerances: RigTolerances | None = None
) -> FloatArray:
    """Expected walks down and up a slope of 2 degrees, each trial with its only gait: four samples, one
    counted cycle, shape (trials, 2)."""
    slopes = [
        replace(nominal, printed=replace(nominal.printed, tilt=float(tilt))) for tilt in (_TILT, -_TILT)
    ]
    lanes = [(t, t.gaits[0], k) for t in trials for _ in slopes for k in range(_SAMPLES_EACH)]
    tilted = [slope for _ in trials for slope in slopes for _ in range(_SAMPLES_EACH)]
    walks = count_falls_as_zero(_walks(lanes, tilted, tolerances))
    return walks.reshape(-1, len(slopes), _SAMPLES_EACH).mean(axis=2)


def _with_hubs(nominal: RobotParameters) -> RobotParameters:
    return replace(nominal, printed=nominal.printed.with_hubs())


def count_falls_as_zero(walks: FloatArray) -> FloatArray:
    """Walks in which a fall counts as no walk."""
    return np.where(np.isfinite(walks), walks, 0.0)


def _walks(
    lanes: Sequence[tuple[Trial, Gait, int]],
    nominal: RobotParameters | Sequence[RobotParameters],
    tolerances: RigTolerances | None,
) -> FloatArray:
    """Walks [body lengths per five cycles] of one sample for each lane, shape (lanes,); minus infinity where
    it fell, folded or came near to buckling a coil. `nominal`: one robot for all lanes or one for each, which
    differ in their mechanics alone."""
    robots_of = [nominal] * len(lanes) if isinstance(nominal, RobotParameters) else nominal
    allowed = tolerances or RigTolerances()
    samples = [
        NominalRobots(trial.body, robot, tolerances=allowed).sample(
            np.random.default_rng([*trial.seed, number])
        )
        for (trial, _, number), robot in zip(lanes, robots_of, strict=True)
    ]
    robots = [build(trial.body, s).coarse() for (trial, _, _), s in zip(lanes, samples, strict=True)]
    springs = [s.motor_springs(trial.body.motors) for (trial, _, _), s in zip(lanes, samples, strict=True)]
    heated = [(gait, own) for (_, gait, _), own in zip(lanes, springs, strict=True)]
    hubs = [trial.body.motor_hubs for trial, _, _ in lanes]
    tables = free_lengths_batch(heated, _CYCLES, many=True, hubs=hubs)  # a cluster's workers have few of them
    free, ground = robots_of[0].free_lengths, lanes[0][0].terrain
    return displacements(robots, tables, _CYCLES, free, _MAX_COIL_LOAD, ground)
