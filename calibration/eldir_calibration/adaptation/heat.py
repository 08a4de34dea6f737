"""How hot the springs of a filmed robot get, and how far they move: what its belief says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldir.built.heat import SpringHistory, SpringState, heat
from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters, perturb_robot
from eldir.parameters.springs import SpringParameters
from eldir_calibration.adaptation.films import CURRENT
from eldir_calibration.adaptation.runs import SpringHeat
from eldir_calibration.dynamics.belief import Belief
from eldir_calibration.dynamics.recording import INTERVAL, Recording
from eldir_calibration.identification.identification import RobotFilms
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.margins import SUPPLY_STEP
from eldir_hardware.schedule import ActuationSchedule

SURE = 1.64
"""Standard deviations on one side: 95 %."""
_MODEL_ERROR = 5.0
"""Error of believed peak temperatures beyond the spread of the members (decision 79) [K]: a film tells
temperatures from the transition of the wire, and that of a batch is known to 3 K."""


def believe_heat(belief: Belief, film: RobotFilms) -> SpringHeat:
    """Heat and strokes of the springs in a film; `belief`: after it."""
    (recording,), current = film.recordings, film.nominal.springs.current_limit
    peak, deviation = _mean_peak(belief, recording.contact_shares, current)
    used, _ = spring_strokes(belief, recording, current)
    mean = used.mean(axis=1)
    return SpringHeat(*(round(float(v), 3) for v in (peak, deviation, mean.mean(), mean.std())))


def keeps_limit(
    belief: Belief,
    film: RobotFilms,
    limit_c: float,
    current_a: float,
    tolerance: float | None = None,
    air_c: float | None = None,
) -> bool:
    """Whether 95 % of the robots that may be the filmed one would have kept a temperature limit in this run
    with this current limit of the supply; with `tolerance`, if it is measured to that. `air_c`: temperature
    of the air [C]; None: the belief's."""
    (recording,) = film.recordings
    belief = belief_in_air(belief, air_c)
    if tolerance is not None:  # the supply gives what it is set to
        known = np.array(belief.names) == CURRENT
        belief, current_a = replace(belief, z=np.where(known, 0.0, belief.z)), current_a * (1 + tolerance)
    peak, deviation = _mean_peak(belief, recording.contact_shares, current_a)
    return peak + SURE * deviation <= limit_c


def belief_in_air(belief: Belief, air_c: float | None) -> Belief:
    """The same robots in air of this temperature [C]; None: in that of the belief."""
    return replace(belief, nominal=replace(belief.nominal, springs=belief.nominal.springs.in_air(air_c)))


def planned_contact_shares(schedule: ActuationSchedule, rig: Rig, motors: int) -> FloatArray:
    """Share of each interval in which a schedule closes the contacts of each motor, as in `Recording`, shape
    (steps, motors)."""
    channels, states = schedule.sampled(INTERVAL)
    own = {entry.channel: entry.spring for entry in rig.channels}
    columns = [[k for k, c in enumerate(channels) if own.get(c) == motor] for motor in range(motors)]
    shares = [states[:, k].mean(axis=1) if k else np.zeros(len(states)) for k in columns]
    return np.stack(shares, axis=1).astype(float)


def find_safe_current(
    belief: Belief,
    film: RobotFilms,
    limit_c: float,
    max_a: float,
    *,
    above_a: float = 0.0,
    tolerance: float | None = None,
    air_c: float | None = None,
) -> float | None:
    """Highest current limit up to `max_a`, and above `above_a`, for which `keeps_limit` holds, in steps of a
    supply [A]; None if there is none. `tolerance` and `air_c` as there."""
    steps = range(int(max_a / SUPPLY_STEP + 1e-6), int(above_a / SUPPLY_STEP + 1e-6), -1)
    currents = (round(SUPPLY_STEP * k, 2) for k in steps)
    return next((c for c in currents if keeps_limit(belief, film, limit_c, c, tolerance, air_c)), None)


def spring_strokes(belief: Belief, recording: Recording, current_a: float) -> tuple[FloatArray, FloatArray]:
    """How far the spring of each motor of each member moves in the cycles that count: as a part of what it
    could, and in metres, shape (N, A) each. `current_a`: current limit of the supply."""
    members = robots_of(belief, current_a)
    each, history = _heat_robots(belief.body.morphology, members, recording.contact_shares)
    strokes = np.ptp(history.length[int(recording.start / INTERVAL) :], axis=0)
    possible = np.array([s.hot_length - s.cold_length for s in each])
    shape = len(belief.z), -1
    return (strokes / possible).reshape(shape), strokes.reshape(shape)


def robots_of(belief: Belief, current_a: float) -> list[RobotParameters]:
    """The members of a belief on a supply with this current limit."""
    springs = replace(belief.nominal.springs, current_limit=current_a)
    nominal = replace(belief.nominal, springs=springs)
    return [perturb_robot(belief.body.morphology, nominal, belief.names, z) for z in belief.z]


def peak_temperatures(
    morphology: Morphology, robots: Sequence[RobotParameters], contact_shares: FloatArray
) -> FloatArray:
    """Highest temperature of the springs of each robot [C], shape (N,), in its own air. `contact_shares` as
    in `Recording`."""
    _, history = _heat_robots(morphology, robots, contact_shares)
    return history.temperature.max(axis=0).reshape(len(robots), -1).max(axis=1)


def _mean_peak(belief: Belief, contact_shares: FloatArray, current_a: float) -> tuple[float, float]:
    """Mean of the members' peak temperatures [C], and their standard deviation with the model's error [K]."""
    peaks = peak_temperatures(belief.body.morphology, robots_of(belief, current_a), contact_shares)
    return float(peaks.mean()), float(np.hypot(peaks.std(), _MODEL_ERROR))


def _heat_robots(
    morphology: Morphology, robots: Sequence[RobotParameters], contact_shares: FloatArray
) -> tuple[list[SpringParameters], SpringHistory]:
    """The springs of all robots, motor by motor, and what they do from cold."""
    each = [s for robot in robots for s in robot.motor_springs(morphology.motors)]
    cold = SpringState(np.array([s.ambient for s in each]), np.ones(len(each)))
    return each, heat(np.tile(contact_shares, (1, len(robots))), INTERVAL, each, cold)
