"""From logs to an identified robot: its markers, its heating, its meters, and the provenance of the
result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from eldir.built.gait import FilmedGait, Gait
from eldir.built.scene import PrintedScene
from eldir.built.screening import candidate_gaits
from eldir.core.files import new_folder, write_bytes
from eldir.core.pictures import png
from eldir.core.version import __version__
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir_calibration.comparison.meters import MeterReadings, read_meters
from eldir_calibration.comparison.motions import track_run
from eldir_calibration.comparison.recorded_run import LoggedRun, open_runs
from eldir_calibration.dynamics import figures as dynamics_figures
from eldir_calibration.dynamics.identifiability import attribute_ranges, rank_experiments
from eldir_calibration.dynamics.recording import (
    INTERVAL,
    FilmedBody,
    Measurements,
    Progress,
    Recording,
    find_any_fall,
)
from eldir_calibration.dynamics.results import STOPPED, identify_robot
from eldir_calibration.report.comparison import Motion
from eldir_hardware.log.mcap_file import fingerprint
from eldir_hardware.planning.compiler import extract_gait

OTHER_JOINTS = (BuiltParameters().with_hubs(), BuiltParameters.clamped())
"""Joints that are tried where pins do not explain the films: hubs, then strips clamped in their hexagons."""
_ATTRIBUTION_STEP, _EXPERIMENT_STEP = "figures: what explains the motion", "figures: what to film next"


class RobotFilms(NamedTuple):
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
    rooms_c: tuple[float | None, ...] = ()
    """Temperature of the air in each log [C]; None where it was not measured."""
    current_is_measured: bool = False
    """Whether the rig file says so (`ToleranceEntry`)."""


def read_films(
    paths: Sequence[Path], design: Design, progress: Progress = lambda what, part: None
) -> RobotFilms:
    """Reads and tracks logs of one robot. Raises `InputError` where their rigs have different springs or
    supplies, or share one output, or where they are of different robots, or of a paused run, or one is there
    twice."""
    runs = open_runs(paths, design)
    for run in runs:
        run.require_unpaused("leave this log out, or film the run again without a pause")
    first = runs[0]
    if any(d.rig.spring_parameters() != first.rig.spring_parameters() for d in runs):
        raise InputError(
            "the logs are of rigs with different springs or supplies",
            code="dynamics.different-rigs",
            remedy="identify each rig separately",
        )
    first.rig.require_own_outputs()
    if any(d.design != first.design for d in runs):
        raise InputError(
            "the logs are of different robots",
            code="dynamics.different-robots",
            remedy="identify each robot separately",
        )
    if first.design.printed_terrain is not None:
        raise InputError(
            f"{first.log.path} shows a robot on a printed ground",
            code="dynamics.terrain",
            expected="films of a robot on a table: where a ground lies under the robot is not measured",
            remedy="film the same body on the table, with a design without printed_terrain",
        )
    recordings = []
    for i, log in enumerate(runs):
        progress("tracking", i / len(paths))
        recordings.append(read_recording(log))
    robot, springs = first.design, first.rig.spring_parameters()
    return RobotFilms(
        FilmedBody(robot.morphology, robot.marks, robot.ballast / 2),
        recordings,
        RobotParameters.nominal(springs),
        tuple(RobotParameters.nominal(springs, joints) for joints in OTHER_JOINTS),
        robot,
        [
            s
            for log, film in zip(runs, recordings, strict=True)
            if (s := read_filmed_gait(log, film)) is not None
        ],
        {
            "eldir": __version__,
            "logs": [path.name for path in paths],
            "fingerprints": [fingerprint(run.log.path) for run in runs],
            "rig": first.rig.name,
        },
        read_meters([(run.log, run.rig) for run in runs], hot=True),
        tuple(run.measured.room_c for run in runs),
        first.rig.tolerances.current_is_measured,
    )


def identify_films(
    films: RobotFilms,
    *,
    weight_g: float | None = None,
    current_a: float | None = None,
    voltage_v: float | None = None,
    seed: int = 0,
    figures: Path | None = None,
    progress: Progress = lambda what, part: None,
) -> PrintedScene:
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
    if figures is not None and STOPPED not in scene.provenance:
        scene = write_figures(films, scene, figures, progress)
    return scene


def read_filmed_gait(run: LoggedRun, film: Recording) -> FilmedGait | None:
    """The gait of a run and how far the camera saw the robot walk; None where the schedule is no gait, or the
    walk is known in no cycle. Of a control robot that followed the intact one's schedule, the gait of the
    motors that it has."""
    gait = extract_gait(run.schedule)
    if gait is None:
        return None
    own = slice(run.design.morphology.motors)
    gait = Gait(gait.period, gait.phase[own], gait.duty[own])
    motion = Motion(film.tracked, film.start, film.period, film.cycles, run.robot.body_length)
    if not motion.known_cycles:
        return None
    fell = find_any_fall(run.robot.positions[run.design.marks], film) is not None
    lost_at = None if fell else film.lost_at
    return FilmedGait.of(gait, motion.displacement(), fell, motion.known_cycles, run.log.path.name, lost_at)


def read_recording(run: LoggedRun, progress: Callable[[int], None] = lambda frames: None) -> Recording:
    """A log as a recording: markers in its frames, or else as tracked during the run; contacts as read
    back."""
    log, names, loss = run.log, run.names, None
    if log.frame_count:
        tracked = track_run(run, progress, through_falls=True)
        motion, loss = tracked.motion, tracked.loss
    elif log.tracks is not None and log.tracks.names == names:
        motion = run.motion(log.tracks)
    else:
        raise InputError(
            f"{log.path} holds no positions of the markers",
            code="log.no-positions",
            expected=f"frames, or tracks of {', '.join(names)}",
            found="no frames" if log.tracks is None else ", ".join(log.tracks.names),
        )
    return Recording(
        motion.trajectory,
        run.contact_shares(INTERVAL),
        motion.start,
        motion.period,
        motion.cycles,
        loss.time_s if loss is not None and loss.kind == "fell sideways" else None,
        run.measured.room_c,
        loss.time_s if loss is not None and loss.kind == "lost" else None,
    )


def write_figures(
    films: RobotFilms, scene: PrintedScene, folder: Path, progress: Progress = lambda what, part: None
) -> PrintedScene:
    """Writes four figures into a new folder; returns the scene with their numbers."""
    last, joints = films.recordings[-1], scene.robot.printed.joints
    nominal = next(n for n in (films.nominal, *films.others) if n.printed.joints == joints)
    found = attribute_ranges(
        films.body, last, nominal, scene, progress=lambda part: progress(_ATTRIBUTION_STEP, part / 2)
    )
    gaits = candidate_gaits(films.body.morphology.motors)
    ranked = rank_experiments(
        films.body, scene, gaits, progress=lambda part: progress(_EXPERIMENT_STEP, (1 + part) / 2)
    )
    drawings = {
        "intervals": dynamics_figures.draw_intervals(scene),
        "held-out": dynamics_figures.draw_held_out(scene, last.tracked.names),
        "explained": dynamics_figures.draw_attribution(found),
        "next": dynamics_figures.draw_experiments(ranked),
    }
    with new_folder(folder) as draft:
        for name, figure in drawings.items():
            write_bytes(draft / f"{name}.png", png(figure))
    numbers = replace(
        scene.identification, explained=found.numbers, next_films=tuple(e.numbers for e in ranked)
    )
    return replace(scene, results=numbers)
