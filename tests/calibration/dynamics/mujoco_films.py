"""Films of robots that MuJoCo moves: hubs, sockets, feet that differ and a table that slopes.

The parameters are hidden as those of `tests.calibration.dynamics.hidden_rigs`; beyond them the film has
what the identified model lacks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eldir.built.heat import SpringState, heat
from eldir.built.robot import build, min_area_ratio
from eldir.built.walking import FOLDED_AREA_RATIO, TOPPLED_ANGLE, rotation
from eldir.core.records import FloatArray
from eldir.design import marked_masses
from eldir.errors import EldirError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.parameters.robot import RobotParameters, sample_feet
from eldir_cad.kit import PRINTER
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.model import Multibody, build_multibody
from eldir_calibration.dynamics.recording import INTERVAL, FilmedBody, Measurements, Recording
from eldir_hardware.virtual.mujoco_body import TILT_SCATTER, MujocoMotion
from tests.calibration.dynamics.hidden_rigs import PERIOD, blank_film, hidden, seen_by_camera

CYCLES = 3
"""Of which the last is held out. The films of the model's own kind have five, which takes twice as long."""
_LAY = 1.5  # the robot lies there, its cold springs pulling, before the film begins [s]
_LEAST_RANGE = 5e-3  # of the mark that moves most [m]


@dataclass(frozen=True)
class SecondRig:
    """A film of a robot in MuJoCo, and what only the test knows."""

    body: FilmedBody
    truth: RobotParameters
    film: Recording
    marks: FloatArray
    """The marks without noise, at the film's frames [m], shape (frames, marks, 2)."""
    measurements: Measurements
    """Weight, current and voltage, each read to 0.5 %."""
    tilt: float
    """The table falls forward by this angle [rad]."""
    fault: str
    """Why such a run would not be filmed: "turns over", "folds", "buckles a coil", "hardly moves", "fails";
    empty if it would."""


def random_body(seed: int, index: int) -> FilmedBody:
    """Design `index` of 220 random ones with two motors on 4 x 8 triangles."""
    lattice = Lattice(4, 8)
    body = develop(lattice, random_genotypes(lattice, 220, np.random.default_rng(seed), 2)[index])
    return FilmedBody(body, marked_masses(body))


def second_rig(
    body: FilmedBody,
    seed: int,
    phase: float,
    cycles: int = CYCLES,
    simpler: Callable[[Multibody], Multibody] = lambda model: model,
    period: float = PERIOD,
) -> SecondRig:
    """The robot with the hidden parameters of `seed`, filmed in MuJoCo over one cycle, and `cycles` that
    count. `simpler` takes laws of the model away (`eldir_cad.multibody.model`)."""
    truth, further = hidden(seed), np.random.default_rng([seed, 6])
    feet = sample_feet(len(body.morphology.positions), further)
    tilt = float(TILT_SCATTER * further.standard_normal())
    model = build_multibody(
        body.morphology,
        load_specification(),
        load_printer(PRINTER),
        truth.printed,
        friction_factors=feet,
        tilt=tilt,
    )
    model = simpler(model)
    blank = blank_film(body, cycles, phase=phase, period=period)
    free = truth.free_lengths
    own = truth.motor_springs(body.morphology.motors)
    cold = SpringState(np.array([s.ambient for s in own]), np.ones(len(own)))
    heated = heat(blank.contact_shares, INTERVAL, own, cold).length
    lay = np.full((round(_LAY / INTERVAL) + 1, len(own)), free[0])
    lengths = np.concatenate([lay, heated])
    try:
        positions, coils = _moved(MujocoMotion(model, free), lengths)
        fault = _fault(body, truth, positions, model.coil_commands(lengths, free)[0] - coils, lengths)
    except EldirError:
        positions, fault = np.full((len(lengths), *body.morphology.positions.shape), np.nan), "fails"
    filmed = positions[len(lay) - 1 :, body.marker_masses]
    times = np.arange(len(filmed)) * INTERVAL
    t = blank.frame_times
    marks = np.stack(
        [[np.interp(t, times, filmed[:, m, d]) for d in range(2)] for m in range(len(body.marker_masses))]
    ).transpose(2, 0, 1)
    if not fault and np.ptp(marks[..., 1], axis=0).max() < _LEAST_RANGE:
        fault = "hardly moves"
    weight = float(build(body.morphology, truth.printed).masses.sum())
    current = float(truth.springs.current(0.0))
    voltage = current * float(truth.springs.resistance_at(0.0))
    read = [
        1 + 0.005 * float(np.random.default_rng([seed, stream]).standard_normal()) for stream in (10, 8, 9)
    ]
    measured = Measurements(weight * read[0], current * read[1], voltage * read[2])
    return SecondRig(body, truth, seen_by_camera(blank, marks, seed), marks, measured, tilt, fault)


def _moved(motion: MujocoMotion, lengths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions of the hubs (T, M, 2), and lengths of the coils between their hinges (T, A) [m]."""
    positions, coils = [motion.positions], []
    for row in range(len(lengths) - 1):
        motion.follow(lengths[row : row + 2], INTERVAL)
        positions.append(motion.positions)
        coils.append(motion.coil_lengths)
    return np.array(positions), np.array(coils[:1] + coils)


def _fault(
    body: FilmedBody,
    truth: RobotParameters,
    positions: FloatArray,
    shortened: FloatArray,
    lengths: FloatArray,
) -> str:
    robot = build(body.morphology, truth.printed)
    if np.abs(rotation(robot.positions, positions)).max() > TOPPLED_ANGLE:
        return "turns over"
    if min_area_ratio(robot, positions) < FOLDED_AREA_RATIO:
        return "folds"
    if (shortened > truth.springs.buckling_shortening(lengths)).any():
        return "buckles a coil"
    return ""
