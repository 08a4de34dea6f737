"""A small walker, and rigs whose parameters the identification never sees: only the tests know them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from eldir.built.gait import SETTLE, Gait
from eldir.built.robot import build
from eldir.design import marked_masses
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.trajectory import Trajectory
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.recording import INTERVAL, FilmedBody, Recording, predict_markers
from eldir_hardware.virtual.bodies import sample_large_spread

NOMINAL = RobotParameters()
SOFT = RobotParameters(BuiltParameters(tension=5e3))
"""Soft strips allow long steps: quick."""
QUICK = replace(DEFAULT_CONFIG, starts=2, refinement_stages=((1, 3),), rounds=(4,), joint_rounds=(3, 3))
"""Few starting points and rounds: enough where the hidden robot is near and its parameters are few."""
CELLS = ((3, 1), (3, 2), (3, 3), (3, 5), (4, 2), (4, 3), (4, 4), (4, 5), (5, 4))
MOTORS = (1, 3), (5, 6)
PHASE, PERIOD, DUTY = 0.875, 20.0, 0.3


LATTICE = Lattice(6, 11)


@cache
def walker_genotype() -> Genotype:
    """Eleven masses that a shortlist of `eldir demo` once held, with two motors."""
    lattice = LATTICE
    mask = np.zeros((lattice.rows, lattice.columns), bool)
    mask[tuple(np.transpose(CELLS))] = True
    there = lattice.expressed_springs(mask)
    passive = develop(lattice, Genotype(mask, np.zeros(len(lattice.springs), bool)))
    own = np.flatnonzero(there)
    active = np.zeros(len(lattice.springs), bool)
    for i, ends in enumerate(passive.springs.tolist()):
        active[own[i]] = tuple(ends) in MOTORS
    return Genotype(mask, active)


@cache
def walker() -> FilmedBody:
    """The body of `walker_genotype`."""
    body: Morphology = develop(LATTICE, walker_genotype())
    return FilmedBody(body, marked_masses(body))


def heating(cycles: int, phase: float = PHASE, period: float = PERIOD) -> np.ndarray:
    """Which part of each interval each motor is on, shape (steps, 2)."""
    gait = Gait(period, np.array([0.0, phase]), np.full(2, DUTY))
    starts = np.arange(round((SETTLE + period * (1 + cycles)) / INTERVAL)) * INTERVAL
    return gait.is_heating(starts - SETTLE + 1e-9).astype(float)


def hidden(seed: int, nominal: RobotParameters = NOMINAL) -> RobotParameters:
    """A robot far from nominal, its strips as long as drawn."""
    far = sample_large_spread(nominal, seed)
    return replace(far, printed=replace(far.printed, geometry=0.0))


def uneven(body: FilmedBody, truth: RobotParameters, seed: int) -> RobotParameters:
    """Its strips 0.3 mm long or short (one sigma), as `build` draws them."""
    drawn = replace(truth.printed, geometry=0.3e-3)
    rng = np.random.default_rng([seed, 7])
    robots = build(body.morphology, drawn, rng=rng), build(body.morphology, truth.printed)
    return replace(truth, strips=robots[0].rest_lengths - robots[1].rest_lengths)


def unequal(body: FilmedBody, truth: RobotParameters, seed: int) -> RobotParameters:
    """Its springs a millimetre or so longer and shorter than each other, the mean of both as it was."""
    rng = np.random.default_rng([seed, 9])
    cold, hot = 1e-3 * rng.choice([-1, 1], 2) * rng.uniform(0.7, 1.5, 2)
    sides, (mean_cold, mean_hot) = np.array([1, -1]), truth.free_lengths
    springs = {"cold_length": mean_cold + sides * cold, "hot_length": mean_hot + sides * hot}
    return truth.with_parts(np.zeros(len(body.morphology.springs)), springs)


def film(
    body: FilmedBody,
    truth: RobotParameters,
    seed: int,
    cycles: int,
    *,
    noise: float = 0.15e-3,
    hidden_share: float = 0.05,
    phase: float = PHASE,
    period: float = PERIOD,
) -> Recording:
    """Ten frames a second of a run, with the camera's noise [m] and marks that hide for a second or so."""
    blank = blank_film(body, cycles, phase=phase, period=period)
    x = predict_markers(body, [blank], [truth])[0][0]
    return seen_by_camera(blank, x, seed, noise=noise, hidden_share=hidden_share)


def blank_film(body: FilmedBody, cycles: int, *, phase: float = PHASE, period: float = PERIOD) -> Recording:
    """A recording at ten frames a second in which nothing moves."""
    on = heating(cycles, phase, period)
    times = np.arange(0, len(on) * INTERVAL, 0.1)
    names = tuple(f"m{i + 1}" for i in range(len(body.marker_masses)))
    nothing = Trajectory(names, times, np.zeros((len(times), len(names), 2)))
    return Recording(nothing, on, SETTLE + period, period, cycles)


def seen_by_camera(
    blank: Recording, x: np.ndarray, seed: int, *, noise: float = 0.15e-3, hidden_share: float = 0.05
) -> Recording:
    """The recording in which marks move as `x` [m], shape (frames, marks, 2), with noise and hidden marks."""
    rng = np.random.default_rng([seed, 5])
    x = x + noise * rng.standard_normal(x.shape)
    names, times = blank.tracked.names, blank.tracked.times
    for mark in range(len(names)):
        frame = int(rng.exponential(10 / hidden_share)) if hidden_share else len(times)
        while frame < len(times):
            x[frame : frame + int(rng.exponential(10)), mark] = np.nan
            frame += int(rng.exponential(10 / hidden_share))
    return replace(blank, tracked=Trajectory(names, times, x))
