"""How hot the springs of a filmed robot get, and how far they move: what its belief says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eldir.built.heat import SpringHistory, SpringState, heat
from eldir.core.records import FloatArray
from eldir.parameters.robot import perturb_robot
from eldir.parameters.springs import SpringParameters
from eldir_calibration.adaptation.films import CURRENT
from eldir_calibration.adaptation.runs import SpringHeat
from eldir_calibration.dynamics.belief import Belief
from eldir_calibration.dynamics.recording import INTERVAL, Recording
from eldir_calibration.identification.identification import RobotFilms

_SURE = 1.64  # standard deviations on one side: 95 %
_CURRENT_STEP = 0.05  # in which a supply is set [A]
_MODEL_ERROR = 5.0
"""Error of believed peak temperatures beyond the spread of the members (decision 79) [K]: a film tells
temperatures from the transition of the wire, and that of a batch is known to 3 K."""


def believe_heat(belief: Belief, film: RobotFilms) -> SpringHeat:
    """Heat and strokes of the springs in a film; `belief`: after it."""
    springs, (recording,) = film.nominal.springs, film.recordings
    peaks = peak_temperatures(belief, springs, recording.contact_shares).max(axis=1)
    used, _ = spring_strokes(belief, springs, recording)
    mean = used.mean(axis=1)
    peak, deviation = _mean_and_error(peaks)
    return SpringHeat(*(round(float(v), 3) for v in (peak, deviation, mean.mean(), mean.std())))


def keeps_limit(
    belief: Belief, film: RobotFilms, limit_c: float, current_a: float, tolerance: float | None = None
) -> bool:
    """Whether 95 % of the robots that may be the filmed one would have kept a temperature limit in this run
    with this current limit of the supply; with `tolerance`, if it is measured to that."""
    (recording,) = film.recordings
    if tolerance is None:
        changed, members = replace(film.nominal.springs, current_limit=current_a), belief
    else:
        changed = replace(film.nominal.springs, current_limit=current_a * (1 + tolerance))
        members = without_current(belief)
    peaks = peak_temperatures(members, changed, recording.contact_shares).max(axis=1)
    peak, deviation = _mean_and_error(peaks)
    return peak + _SURE * deviation <= limit_c


def _mean_and_error(peaks: FloatArray) -> tuple[float, float]:
    """Mean of the members' peak temperatures [C], and their standard deviation with the model's error [K]."""
    return float(peaks.mean()), float(np.hypot(peaks.std(), _MODEL_ERROR))


def without_current(belief: Belief) -> Belief:
    """The same members on a supply that gives what it is set to."""
    return replace(belief, z=np.where(np.array(belief.names) == CURRENT, 0.0, belief.z))


def find_safe_current(belief: Belief, film: RobotFilms, limit_c: float) -> float:
    """Highest current limit, not above that of the run, for which `keeps_limit` holds, in steps of a supply
    [A]; the lowest step where none is found."""
    steps = range(int(film.nominal.springs.current_limit / _CURRENT_STEP), 1, -1)
    currents = (round(_CURRENT_STEP * k, 2) for k in steps)
    return next((c for c in currents if keeps_limit(belief, film, limit_c, c)), _CURRENT_STEP)


def spring_strokes(
    belief: Belief, springs: SpringParameters, recording: Recording
) -> tuple[FloatArray, FloatArray]:
    """How far the spring of each motor of each member moves in the cycles that count: as a part of what it
    could, and in metres, shape (N, A) each. `springs`: those of the run, as they should be."""
    each, history = _heat_members(belief, springs, recording.contact_shares)
    strokes = np.ptp(history.length[int(recording.start / INTERVAL) :], axis=0)
    possible = np.array([s.hot_length - s.cold_length for s in each])
    shape = len(belief.z), -1
    return (strokes / possible).reshape(shape), strokes.reshape(shape)


def peak_temperatures(belief: Belief, springs: SpringParameters, contact_shares: FloatArray) -> FloatArray:
    """Highest temperature of the spring of each motor of each member [C], shape (N, A). `springs`: those of
    the run, as they should be; `contact_shares` as in `Recording`."""
    _, history = _heat_members(belief, springs, contact_shares)
    return history.temperature.max(axis=0).reshape(len(belief.z), -1)


def _heat_members(
    belief: Belief, springs: SpringParameters, contact_shares: FloatArray
) -> tuple[list[SpringParameters], SpringHistory]:
    """The springs of all members, motor by motor, and what they do from cold."""
    morphology = belief.body.morphology
    nominal = replace(belief.nominal, springs=springs)
    members = [perturb_robot(morphology, nominal, belief.names, z) for z in belief.z]
    each = [s for robot in members for s in robot.motor_springs(morphology.motors)]
    cold = SpringState(np.array([s.ambient for s in each]), np.ones(len(each)))
    return each, heat(np.tile(contact_shares, (1, len(members))), INTERVAL, each, cold)
