"""From logs to an identified robot: its marks, its heating, and the provenance of the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eldir.built.filmed_gait import FilmedGait
from eldir.built.gait import Gait
from eldir.built.scene import BuiltScene
from eldir.built.screening import candidate_gaits
from eldir.core.files import new_folder, write_bytes
from eldir.core.pictures import png
from eldir.core.records import FloatArray
from eldir.core.version import __version__
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir_calibration.comparison.motions import filmed
from eldir_calibration.comparison.recorded_run import LoggedRun, open_runs
from eldir_calibration.dynamics import figures as dynamics_figures
from eldir_calibration.dynamics.identifiability import attribute_ranges, rank_experiments
from eldir_calibration.dynamics.least_squares.starting_points import Progress
from eldir_calibration.dynamics.measurements import Measurements
from eldir_calibration.dynamics.recording import INTERVAL, FilmedBody, Recording, stayed_upright
from eldir_calibration.dynamics.results import identify_robot
from eldir_calibration.identification.meter_readings import MeterReadings, meter_readings
from eldir_calibration.report.comparison import Motion
from eldir_hardware.log.reader import RunLog
from eldir_hardware.planning.compiler import gait_of
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule

OTHER_JOINTS = (BuiltParameters().with_hubs(), BuiltParameters.clamped())
"""Joints that are tried where pins do not explain the films: hubs, then strips clamped in their hexagons."""

_EXPLAINED, _NEXT = "figures: what explains the motion", "figures: what to film next"


class Films(NamedTuple):
    """Logs of one robot as `eldir_calibration.dynamics.results.identify_robot` takes them."""

    body: FilmedBody
    recordings: list[Recording]
    nominal: RobotParameters
    others: tuple[RobotParameters, ...]
    """Nominal robots with other joints (`OTHER_JOINTS`)."""
    design: Design
    """The robot that was filmed, with its ballast."""
    filmed_gaits: list[FilmedGait]
    """The gaits in the logs, and how far the camera saw the robot walk with each."""
    provenance: dict[str, Any]
    readings: MeterReadings | None = None
    """Current and voltage of hot springs, where the logs hold them."""


def films_of(paths: Sequence[Path], design: Design, progress: Progress = lambda what, part: None) -> Films:
    """Reads and tracks logs of one robot. Raises `InputError` where their rigs have different springs or
    supplies, or where they are of different robots, or one is there twice."""
    runs = open_runs(paths, design)
    first = runs[0]
    if any(d.rig.spring_parameters() != first.rig.spring_parameters() for d in runs):
        raise InputError(
            "the logs are of rigs with different springs or supplies",
            code="dynamics.different-rigs",
            remedy="identify each rig separately",
        )
    if any(d.design != first.design for d in runs):
        raise InputError(
            "the logs are of different robots",
            code="dynamics.different-robots",
            remedy="identify each robot separately",
        )
    recordings = []
    for i, log in enumerate(runs):
        progress("tracking", i / len(paths))
        recordings.append(recording_of(log))
    robot, springs = first.design, first.rig.spring_parameters()
    return Films(
        FilmedBody(robot.morphology, robot.marks, robot.ballast / 2),
        recordings,
        RobotParameters(springs=springs),
        tuple(RobotParameters(joints, springs) for joints in OTHER_JOINTS),
        robot,
        [s for log, film in zip(runs, recordings, strict=True) if (s := filmed_gait(log, film)) is not None],
        {"eldir": __version__, "logs": [path.name for path in paths], "rig": first.rig.name},
        meter_readings(runs),
    )


def identify_films(
    films: Films,
    *,
    weight_g: float | None = None,
    current_a: float | None = None,
    voltage_v: float | None = None,
    seed: int = 0,
    figures: Path | None = None,
    progress: Progress = lambda what, part: None,
) -> BuiltScene:
    """The identified robot, with the gaits that were filmed.

    Args:
        weight_g: mass of the whole robot, which has two planes [g].
        current_a: current through one hot spring alone [A]; default: the one in the logs, if any.
        voltage_v: voltage across the same spring [V]; default: the one in the logs, if any.
        seed: random seed of the optimiser's starting points.
        figures: folder for figures and their numbers, which take minutes more.
    """
    of_one_plane = None if weight_g is None else 1e-3 * weight_g / 2  # [kg]
    read = films.readings
    error = None if read is None or None not in (current_a, voltage_v) else read.error
    if read is not None:
        current_a, voltage_v = current_a or read.current_a, voltage_v or read.voltage_v
    scene = identify_robot(
        films.body,
        films.recordings,
        films.nominal,
        others=films.others,
        measurements=Measurements(of_one_plane, current_a, voltage_v, error),
        seed=seed,
        progress=progress,
        provenance=films.provenance
        | {"seed": seed, "weight_g": weight_g, "current_a": current_a, "voltage_v": voltage_v}
        | ({} if error is None else {"meter_error": error}),
    )
    ballast = films.design.ballast
    scene = replace(
        scene,
        body=films.design.body,
        ballast_kg=ballast if ballast.any() else ballast[:0],
        filmed_gaits=tuple(films.filmed_gaits),
    )
    if figures is not None:
        scene = write_figures(films, scene, figures, progress)
    return scene


def filmed_gait(run: LoggedRun, film: Recording) -> FilmedGait | None:
    """The gait of a run and how far the camera saw the robot walk; None where the schedule is no gait. Of a
    control robot that followed the intact one's schedule, the gait of the motors that it has."""
    gait = gait_of(run.schedule)
    if gait is None:
        return None
    own = slice(run.design.morphology.motors)
    gait = Gait(gait.period, gait.phase[own], gait.duty[own])
    motion = Motion(film.tracked, film.start, film.period, film.cycles, run.robot.body_length)
    upright = stayed_upright(run.robot.positions[run.design.marks], film.tracked)
    return FilmedGait.of(gait, motion.displacement(), upright, film.cycles, run.log.path.name)


def recording_of(run: LoggedRun, progress: Callable[[int], None] = lambda frames: None) -> Recording:
    """A log as a recording: marks in its frames, or else as tracked during the run; contacts as read back."""
    log, schedule, names = run.log, run.schedule, run.names
    if log.frame_count:
        motion = filmed(run, progress).motion
    elif log.tracks is not None and log.tracks.names == names:
        motion = run.motion(log.tracks)
    else:
        raise InputError(
            f"{log.path} holds no positions of the marks",
            code="log.no-positions",
            expected=f"frames, or tracks of {', '.join(names)}",
            found="no frames" if log.tracks is None else ", ".join(log.tracks.names),
        )
    on = contact_shares(log, schedule, run.rig, run.design.morphology.motors)
    return Recording(motion.trajectory, on, motion.start, motion.period, motion.cycles)


def contact_shares(log: RunLog, schedule: ActuationSchedule, rig: Rig, motors: int) -> FloatArray:
    """Share of each interval in which each motor's contacts were closed, shape (steps, motors)."""
    if not len(log.relay_times):
        raise InputError(
            f"{log.path} does not say when contacts closed",
            code="log.no-contacts",
            expected="read-backs of the relays",
        )
    edges = np.arange(int(np.ceil(schedule.duration / INTERVAL)) + 1) * INTERVAL
    closed, faces = np.zeros((motors, len(edges) - 1)), np.zeros(motors)
    for entry in rig.channels:
        if entry.spring < motors:
            times = _switchings(log, schedule, entry.channel)
            # What is closed at the end stays closed.
            until = np.append(times, [np.inf] * (len(times) % 2)).reshape(-1, 2, 1)
            since, until = np.clip(until[:, 0], 0, edges[-1]), np.clip(until[:, 1], 0, edges[-1])
            overlap = np.minimum(until, edges[1:]) - np.maximum(since, edges[:-1])
            closed[entry.spring] += np.maximum(overlap, 0.0).sum(axis=0) / INTERVAL
            faces[entry.spring] += 1
    return (closed / np.maximum(faces, 1)[:, None]).T


def _switchings(log: RunLog, schedule: ActuationSchedule, channel: int) -> FloatArray:
    """When a channel closed and opened, alternately [s].

    Two read-backs enclose a switching only to half a second, in which a spring may get a centimetre longer.
    So the switching counts at the time when it was due, if that lies between them. Otherwise (after a pause,
    or where a contact stuck) it counts in the middle.
    """
    states = np.concatenate([[False], log.relays[:, channel - 1]])
    times = np.concatenate([log.relay_times[:1], log.relay_times])
    due = [(t, changes[channel]) for t, changes in schedule.switchings() if channel in changes]
    found = []
    for i in np.flatnonzero(states[1:] != states[:-1]):
        before, after = times[i], times[i + 1]
        planned = [t for t, on in due if on == states[i + 1] and before <= t <= after]
        found.append(planned[0] if planned else (before + after) / 2)
    return np.array(found)


def write_figures(
    films: Films, scene: BuiltScene, folder: Path, progress: Progress = lambda what, part: None
) -> BuiltScene:
    """Writes four figures into a new folder; returns the scene with their numbers."""
    last, joints = films.recordings[-1], scene.robot.printed.joints
    nominal = next(n for n in (films.nominal, *films.others) if n.printed.joints == joints)
    found = attribute_ranges(
        films.body, last, nominal, scene, progress=lambda part: progress(_EXPLAINED, part / 2)
    )
    gaits = candidate_gaits(films.body.morphology.motors)
    ranked = rank_experiments(films.body, scene, gaits, progress=lambda part: progress(_NEXT, (1 + part) / 2))
    drawn = {
        "intervals": dynamics_figures.intervals(scene),
        "held-out": dynamics_figures.held_out(scene, last.tracked.names),
        "explained": dynamics_figures.explained(found),
        "next": dynamics_figures.next_films(ranked),
    }
    with new_folder(folder) as draft:
        for name, figure in drawn.items():
            write_bytes(draft / f"{name}.png", png(figure))
    numbers = replace(
        scene.identification, explained=found.numbers, next_films=tuple(e.numbers for e in ranked)
    )
    return replace(scene, results=numbers)
