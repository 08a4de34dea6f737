"""Why a robot does not walk, as its last film and meters show it.

A fault is stated only where the film itself shows it; where the belief tells one thing and the film does not,
nothing is said. How far the springs move is read from the belief, whose members move as the film does: the
ends of a motor mostly carry no markers.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from eldir.built.heat import HeatModel
from eldir.built.robot import build
from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_calibration.adaptation.films import in_room
from eldir_calibration.adaptation.heat import SURE, believe_heat, find_safe_current, spring_strokes
from eldir_calibration.adaptation.runs import Fault
from eldir_calibration.dynamics.belief import Belief
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.recording import INTERVAL, FilmedBody, Recording, find_any_fall, moves
from eldir_calibration.identification.identification import RobotFilms
from eldir_calibration.report.comparison import PHASE_SAMPLES, Motion

_MAX_IDLE = 0.2
"""A motor does nothing if its stroke is at most this part of the longest one's: of springs that work it is
0.6 and more."""
_MIN_EXPLAINED = 0.96
"""The other motors must explain at least this part of the film's shape: of two that work one explains up to
0.95."""
_MAX_COLD = 0.55
"""Springs are too cold if they use at most this part of their stroke."""
_MAX_REST = 1e-3
"""A foot rests if its marker keeps within this [m], six standard deviations of the camera's noise."""
_MIN_SHAPE = 1e-3
"""The springs move the robot if its shape changes by this, root mean square [m]."""
_WEAK = 1.4
"""A supply is weak if its current is lower than set by more than this multiple of its tolerance."""
_CURRENTS = (0.9, 1.0, 1.1, 1.25)
"""Springs with these multiples of the current span the responses of a motor that may be filmed."""
_GROUND = 1e-6  # heights of masses that stand on the ground at rest [m]


def find_faults(
    number: int,
    film: RobotFilms,
    belief: Belief,
    limit_c: float,
    current_tolerance: float = RigTolerances.current,
) -> tuple[Fault, ...]:
    """Why the robot does not walk in run `number`, or must not go on: its springs get hotter than `limit_c`,
    it fell, the supply gives less than it is set to, a motor does nothing, a foot does not leave its place,
    or the springs stay too cold. Empty if the film shows none of these. `belief`: after the film.
    `current_tolerance`: of the supply, relative."""
    (recording,) = film.recordings
    if hot := _find_hot_springs(number, film, belief, limit_c):
        return hot
    fall = find_any_fall(build(film.body.morphology).positions[film.body.marker_masses], recording)
    if fall is not None:
        sideways = " sideways" if fall == recording.fell_at else ""
        return (
            Fault(
                number,
                "fall",
                f"the robot falls{sideways} at {fall:.0f} s",
                "if it falls with every gait, take another design, or this one with ballast, in a new folder",
            ),
        )
    return (
        _find_weak_supply(number, film, current_tolerance)
        or _find_idle_motors(number, film, belief)
        or _find_stuck_feet(number, film.body, recording)
        or _find_cold_springs(number, film, belief)  # last: springs that are held are believed to be cold
    )


def _find_weak_supply(number: int, film: RobotFilms, tolerance: float) -> tuple[Fault, ...]:
    read, springs = film.readings, film.nominal.springs
    if read is None:
        return ()
    expected = float(springs.current(0.0))
    if read.current_a * (1 + read.current_error) >= (1 - _WEAK * tolerance) * expected:
        return ()
    return (
        Fault(
            number,
            "supply",
            f"the sensor measures {read.current_a:.2f} A in hot springs instead of {expected:.2f} A",
            "check the supply's current limit and voltage, contacts and leads",
        ),
    )


def _find_idle_motors(number: int, film: RobotFilms, belief: Belief) -> tuple[Fault, ...]:
    (recording,) = film.recordings
    _, strokes = spring_strokes(belief, recording, film.nominal.springs.current_limit)
    mean = strokes.mean(axis=0)
    idle = [a for a, stroke in enumerate(mean) if stroke <= _MAX_IDLE * mean.max()]
    working = [a for a in range(len(mean)) if a not in idle]
    springs = in_room(film.nominal.springs, film)
    if not idle or explained_share(film.body, recording, springs, working) < _MIN_EXPLAINED:
        return ()
    return tuple(
        Fault(
            number,
            "motor",
            f"motor {a} does nothing: the robot's shape follows the heating of the other motors alone",
            f"check wiring, contacts and leads of both springs of motor {a}: eldir rig doctor --wiring "
            "warms one after the other",
        )
        for a in idle
    )


def _find_hot_springs(number: int, film: RobotFilms, belief: Belief, limit_c: float) -> tuple[Fault, ...]:
    heat = believe_heat(belief, film)
    if not belief.explains or heat.peak_c <= limit_c:
        return ()
    low, high = heat.peak_interval
    lower = find_safe_current(belief, film, limit_c, film.nominal.springs.current_limit)
    less = "" if lower is None else f" to {lower:.2f} A"
    get, so = ("get", ", so") if low > limit_c else ("may get", "; then")
    return (
        Fault(
            number,
            "hot",
            f"the springs {get} hotter than the limit of {limit_c:g} C: the film tells {heat.peak_c:.0f} C "
            f"({low:.0f} to {high:.0f}){so} they have more current or are cooled less than the rig file says",
            f"lower the current limit{less}, at the supply and in the rig file, or measure the current and "
            "the springs (eldir calibrate springs)",
            lower,
        ),
    )


def _find_cold_springs(number: int, film: RobotFilms, belief: Belief) -> tuple[Fault, ...]:
    if not belief.explains:
        return ()
    if not moves(film.recordings[0]):
        return (
            Fault(
                number,
                "cold",
                "the robot hardly moves: its springs stay too cold, or something holds it",
                "look whether the feet are free and the supply is on (if it was off, begin a new folder); "
                "then measure the current, and turn the supply up as far as the limits allow",
            ),
        )
    used, _ = spring_strokes(belief, film.recordings[0], film.nominal.springs.current_limit)
    mean = used.mean(axis=0)
    if (mean + SURE * used.std(axis=0)).max() > _MAX_COLD:
        return ()
    return (
        Fault(
            number,
            "cold",
            f"the springs use {mean.max():.0%} of their stroke: they stay too cold",
            "measure the current, turn the supply up as far as the limits allow, keep draughts away",
        ),
    )


def _find_stuck_feet(number: int, body: FilmedBody, recording: Recording) -> tuple[Fault, ...]:
    motion = _motion(body, recording)
    heights = body.morphology.positions[:, 1]
    feet = np.flatnonzero(heights[body.marker_masses] <= heights.min() + _GROUND)
    inside = (recording.tracked.times >= recording.start) & (recording.tracked.times <= recording.end)
    forward = recording.tracked.positions[inside][:, feet, 0]
    if not len(feet) or not _are_visible(recording, feet):
        return ()
    moved = np.nanpercentile(forward, 97.5, axis=0) - np.nanpercentile(forward, 2.5, axis=0)
    shape = float(np.sqrt(np.mean(_mean_shape(motion) ** 2)))
    names = [recording.tracked.names[k] for k, m in zip(feet, moved, strict=True) if m <= _MAX_REST]
    if not names or shape < _MIN_SHAPE:
        return ()
    return (
        Fault(
            number,
            "stuck",
            f"the foot with marker {', '.join(names)} does not leave its place, although the springs move",
            "clean the feet and the table, look for a foot that is caught, or lay another surface",
        ),
    )


def _are_visible(recording: Recording, markers: IntArray) -> bool:
    """Whether each of these markers was seen in enough frames of every cycle that counts."""
    t, seen = recording.tracked.times, np.isfinite(recording.tracked.positions[:, markers, 0])
    ends = recording.start + recording.period * np.arange(recording.cycles + 1)
    cycles = [seen[(t >= a) & (t <= b)] for a, b in pairwise(ends)]
    return all(len(c) and c.mean(axis=0).min() >= DEFAULT_CONFIG.min_visible_share for c in cycles)


def explained_share(
    body: FilmedBody, recording: Recording, springs: SpringParameters, motors: list[int]
) -> float:
    """Share of the variance of the filmed shape, in the mean cycle, that follows the heating of these motors
    alone: of a linear fit to the responses of springs with different currents."""
    shape = _mean_shape(_motion(body, recording))
    begin, step = recording.start, recording.period / PHASE_SAMPLES
    at = ((begin + step * (np.arange(PHASE_SAMPLES) + 0.5)) / INTERVAL).astype(int)
    columns = []
    for motor in motors:
        on = recording.contact_shares[:, [motor] * len(_CURRENTS)]
        each = [replace(springs, current_limit=c * springs.current_limit) for c in _CURRENTS]
        length = HeatModel(each).run(on, INTERVAL).length[at]
        part = (length - springs.cold_length) / (springs.hot_length - springs.cold_length)
        columns += [part, part**2]
    if not columns or not shape.any():
        return 0.0
    table = np.concatenate(columns, axis=1)
    table -= table.mean(axis=0)
    fit, *_ = np.linalg.lstsq(table, shape, rcond=1e-4)
    return float(1.0 - np.sum((shape - table @ fit) ** 2) / np.sum(shape**2))


def _mean_shape(motion: Motion) -> FloatArray:
    """Heights, and forward places relative to the markers' mean, over the mean cycle, less their means [m],
    shape (PHASE_SAMPLES, 2 markers): of the markers that have a place throughout the cycle in which most of
    them have, over the cycles in which all of these have; zeros without such markers."""
    x = motion.by_phase()
    whole: BoolArray = np.all(np.isfinite(x), axis=(1, 3))
    markers = whole[whole.sum(axis=1).argmax()]
    if not markers.any():
        return np.zeros((PHASE_SAMPLES, 2))
    x = x[whole[:, markers].all(axis=1)][:, :, markers].mean(axis=0)
    forward = x[..., 0] - x[..., 0].mean(axis=1, keepdims=True)
    shape = np.concatenate([forward, x[..., 1]], axis=1)
    return shape - shape.mean(axis=0)


def _motion(body: FilmedBody, recording: Recording) -> Motion:
    length = build(body.morphology).body_length
    return Motion(recording.tracked, recording.start, recording.period, recording.cycles, length)
