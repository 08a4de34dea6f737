"""Runs of one robot on one table: drive, film, believe, choose the next gait, until none is worth a run.

A folder keeps everything: `run_01/schedule.json`, `run_01/run_01.mcap`, from the second run on the belief
that chose its gait, `run_02/belief.json`; `adaptation.json`; at the end `schedule.json` of the best filmed
gait and `belief.json`. Beliefs and gaits depend on films, rig and seed alone: an adaptation that was
interrupted goes on with the same decisions. The supply may be turned up between two runs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from eldir.built.robot import build
from eldir.built.scene import PrintedScene
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_calibration.adaptation.choice import NoGaitError, advise_supply, discrepancy, plan_run
from eldir_calibration.adaptation.runs import Adaptation, AdaptationConfig, AdaptationRun, best_run
from eldir_calibration.dynamics.belief import believe
from eldir_calibration.dynamics.recording import (
    NOT_MEASURED,
    Measurements,
    Progress,
    find_fall,
    require_informative,
)
from eldir_calibration.identification.identification import RobotFilms, read_films
from eldir_hardware.planning.plan import PlanConfig
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule

Drive = Callable[[ActuationSchedule, Path], None]
"""A function that plays a schedule and writes its log; it raises if the run was not played to its end."""
_SCHEDULE, _BELIEF, _SUMMARY = "schedule.json", "belief.json", "adaptation.json"
_MISFIT = "misfit"  # entry of a belief's provenance


def adapt(
    design_file: Path,
    rig: Rig,
    folder: Path,
    drive: Drive,
    config: AdaptationConfig = AdaptationConfig(),  # noqa: B008 # immutable
    progress: Progress = lambda what, part: None,
    on_run: Callable[[int, AdaptationRun], None] = lambda number, run: None,
) -> Adaptation:
    """Make runs in `folder`, a new one or that of an adaptation that goes on, until no gait is expected to
    walk farther, or there are `config.runs`.

    `on_run` is called with each run after its film was read. The log of a film that cannot be used is kept
    under another name, and the run is repeated by the next call. Raises `InputError` for a robot on a printed
    ground, whose films do not tell where it is, and for logs of other springs.
    """
    design = Design.load(design_file)
    _require_table(design)
    summary = folder / _SUMMARY
    runs = list(Adaptation.load(summary).runs) if summary.exists() else []
    films = [_read(folder / run.log, design, rig, progress) for run in runs]
    scene = _believe(design, rig, films, config, progress) if films else None
    ended = f"all {config.runs} runs are made"
    while len(runs) < config.runs:
        place = folder / f"run_{len(runs) + 1:02d}"
        log = place / f"{place.name}.mcap"
        plans = PlanConfig(
            seed=config.seed + len(runs),
            samples=config.samples,
            cycles=config.cycles,
            design_file=os.path.relpath(design_file, place),
            scene=scene,
        )
        if log.exists():  # the run before was interrupted after it was played
            schedule = ActuationSchedule.load(place / _SCHEDULE)
        else:
            try:
                schedule = plan_run(design, rig, plans, runs, config, lambda what: progress(what, 0.0))
            except NoGaitError as reason:
                ended = str(reason)
                break
            place.mkdir(parents=True, exist_ok=True)
            if scene is not None:
                scene.save(place / _BELIEF)
            schedule.save(place / _SCHEDULE)
            _drive(drive, schedule, log)
        try:
            films.append(_read(log, design, rig, progress))
        except InputError:
            _set_aside(log)  # else the same command would fail for ever
            raise
        runs.append(_record(log, design, schedule, films[-1], scene))
        _save(folder, Adaptation(tuple(runs), best_run(runs), ""))
        on_run(len(runs), runs[-1])
        scene = _believe(design, rig, films, config, progress)
    assert scene is not None  # of one run at least
    scene.save(folder / _BELIEF)
    advice = () if best_run(runs) is None else advise_supply(design, rig, folder, runs, scene, config)
    return _save(folder, Adaptation(tuple(runs), best_run(runs), ended, advice))


def _require_table(design: Design) -> None:
    if design.printed_terrain is not None:
        raise InputError(
            "the robot stands on a printed ground",
            code="dynamics.terrain",
            expected="a robot on a table: where a ground lies under the robot is not measured",
            remedy="use a design of the same body without printed_terrain",
        )


def _drive(drive: Drive, schedule: ActuationSchedule, log: Path) -> None:
    """Play a schedule. A log gets its name when the run was played to its end; one of an interrupted run is
    kept beside it."""
    partial = log.with_name("playing.mcap")
    if partial.exists():
        _set_aside(partial)
    drive(schedule, partial)
    partial.rename(log)


def _set_aside(log: Path) -> None:
    """Keep a log that does not count under another name."""
    count = len(list(log.parent.glob("interrupted_*.mcap"))) + 1
    log.rename(log.with_name(f"interrupted_{count:02d}.mcap"))


def _read(log: Path, design: Design, rig: Rig, progress: Progress) -> RobotFilms:
    """The film of a run. Raises `InputError` if it shows too little, or if its springs differ in more than
    the supply's current limit."""
    films = read_films([log], design, progress)
    require_informative(films.recordings)
    springs = rig.spring_parameters()
    if replace(films.nominal.springs, current_limit=springs.current_limit) != springs:
        raise InputError(
            f"the springs or the supply of {log} are not those of the rig file",
            code="dynamics.different-rigs",
            expected="the same, but for supply.current_limit_a",
            remedy="begin a new folder",
        )
    return films


def _believe(
    design: Design, rig: Rig, films: Sequence[RobotFilms], config: AdaptationConfig, progress: Progress
) -> PrintedScene:
    """The belief after all films, for the present supply, in the air of the last run. Films of a robot that
    fell count until it fell, if that is later than the start of its first cycle."""
    rest, hubs = build(design.morphology).positions[design.marks], BuiltParameters().with_hubs()
    recordings, filmed = [], []
    for film in films:
        (recording,) = film.recordings
        fall = find_fall(rest, recording.tracked)
        if fall is None or fall > recording.start:
            recordings.append(recording if fall is None else recording.truncate(fall))
            filmed.append(RobotParameters(hubs, _in_room(film.nominal.springs, film)))
    nominal = RobotParameters(hubs, _in_room(rig.spring_parameters(), films[-1]))
    read, measured = films[-1].readings, NOT_MEASURED
    if read is not None and recordings and fall is None:
        measured = Measurements(None, read.current_a, read.voltage_v, read.error)
    belief = believe(
        films[-1].body,
        recordings,
        nominal,
        filmed=filmed,
        measurements=measured,
        seed=config.seed,
        progress=progress,
        config=config.belief,
    )
    limit = nominal.springs.current_limit
    return replace(
        belief.scene,
        body=design.body,
        ballast_kg=design.ballast if design.ballast.any() else design.ballast[:0],
        filmed_gaits=tuple(
            gait
            for film in films
            for gait in film.filmed_gaits
            if film.nominal.springs.current_limit == limit
        ),
        provenance=films[-1].provenance
        | {"logs": [name for film in films for name in film.provenance["logs"]]}
        | {"seed": config.seed, _MISFIT: belief.misfit},
    )


def _in_room(springs: SpringParameters, film: RobotFilms) -> SpringParameters:
    """The springs in the air that was measured before a run."""
    (room,) = film.rooms_c
    return springs if room is None else replace(springs, ambient=room)


def _record(
    log: Path, design: Design, schedule: ActuationSchedule, films: RobotFilms, scene: PrintedScene | None
) -> AdaptationRun:
    """`scene`: the belief before the run."""
    (film,) = films.filmed_gaits
    folder, mean, deviation = log.parent.name, None, None
    bias, error = (0.0, 0.0) if scene is None else discrepancy(design, scene)
    if (walk := schedule.predicted.walk) is not None and walk.mean is not None:
        mean, deviation = round(walk.mean - bias, 4), round(float(np.hypot(walk.spread or 0.0, error)), 4)
    return AdaptationRun(
        f"{folder}/{_SCHEDULE}",
        f"{folder}/{log.name}",
        films.nominal.springs.current_limit,
        mean,
        deviation,
        None if scene is None else round(float(scene.provenance[_MISFIT]), 4),
        round(film.walked, 4),
        film.upright,
    )


def _save(folder: Path, found: Adaptation) -> Adaptation:
    """Write the summary, and the schedule of the best run."""
    found.save(folder / _SUMMARY)
    if found.best is not None:
        ActuationSchedule.load(folder / found.runs[found.best - 1].schedule).save(folder / _SCHEDULE)
    return found
