"""Runs of one robot on one table: drive, film, believe, choose the next gait, until none is worth a run.

A folder keeps everything: `run_01/schedule.json`, `run_01/run_01.mcap`, from the second run on the belief
that chose its gait, `run_02/belief.json`; `adaptation.json`; at the end `schedule.json` of the best filmed
gait, `belief.json` and the report, `adaptation.html`. Beliefs and gaits depend on films, rig, seed and prior
alone: an adaptation that was interrupted goes on with the same decisions. The supply may be turned up or down
between two runs; walks with another current do not count as the best one then.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldir.built.scene import PrintedScene
from eldir.design import Design
from eldir.errors import InputError
from eldir_calibration.adaptation.choice import (
    BestRun,
    NoGaitError,
    advise_supply,
    believed_robots,
    discrepancy,
    plan_run,
)
from eldir_calibration.adaptation.faults import find_faults
from eldir_calibration.adaptation.films import (
    MISFIT,
    FilmedWalk,
    believe_films,
    filmed_walks,
    known_parameters,
    nominal_robot,
    read_run,
)
from eldir_calibration.adaptation.heat import belief_in_air, believe_heat
from eldir_calibration.adaptation.page import write_film, write_page
from eldir_calibration.adaptation.prior import BELIEF, find_prior
from eldir_calibration.adaptation.runs import (
    Adaptation,
    AdaptationConfig,
    AdaptationRun,
    Fault,
    SpringHeat,
    best_run,
    repeatable_runs,
)
from eldir_calibration.comparison.recorded_run import open_run
from eldir_calibration.dynamics.belief import Belief
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.recording import Progress, moves
from eldir_calibration.identification.identification import RobotFilms
from eldir_hardware.planning.plan import PlanConfig
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule

Drive = Callable[[ActuationSchedule, Path], None]
"""A function that plays a schedule and writes its log; it raises if the run was broken off, not if a person
ended it after a whole cycle."""
_SCHEDULE, _SUMMARY = "schedule.json", "adaptation.json"
_TO_REPAIR = ("supply", "motor", "stuck")
_TOO_HOT = "hot"


class _Deadline:
    """The time after which no run may end."""

    def __init__(self, minutes: float | None, clock: Callable[[], float]):
        self._minutes, self._clock = minutes, clock
        self._end = None if minutes is None else clock() + 60 * minutes

    def require(self, seconds: float) -> None:
        """Raise `NoGaitError` if so many seconds are not left."""
        if self._end is not None and self._clock() + seconds > self._end:
            raise NoGaitError(f"the next run would end after {self._minutes:g} minutes")


def adapt(
    design_file: Path,
    rig: Rig,
    folder: Path,
    drive: Drive,
    config: AdaptationConfig = AdaptationConfig(),  # noqa: B008 # immutable
    progress: Progress = lambda what, part: None,
    on_run: Callable[[int, AdaptationRun], None] = lambda number, run: None,
    *,
    ask: Callable[[int, ActuationSchedule], None] = lambda number, schedule: None,
    prior: Sequence[Path] = (),
    room_c: float | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Adaptation:
    """Make runs in `folder`, a new one or that of an adaptation that goes on, until no gait is expected to
    walk farther, or there are `config.runs`, or the next one would end after `config.minutes`, or the last
    film shows a fault that must be repaired.

    `ask` is called before each run with its number and schedule, and returns when it may heat; `on_run` is
    called with each run after its film was read. `prior`: folders of adaptations of other robots of the kit;
    they count from the first run on, so that a folder with runs has them already. `room_c`: temperature of
    the air [C] for which runs are planned, if it was measured; else later runs are planned for that of the
    last film. The log of a film that cannot be used is kept under another name, and the run is repeated by
    the next call. Raises `InputError` for a robot on a printed ground, whose films do not tell where it is,
    for one with too few markers, for springs that share the current of one output, which is not simulated,
    and for logs of other springs, rigs or robots.
    """
    deadline = _Deadline(config.minutes, clock)
    design, current = Design.load(design_file), rig.spring_parameters().current_limit
    _require_learnable(design, rig)
    summary = folder / _SUMMARY
    begun = Adaptation.load(summary) if summary.exists() else Adaptation((), None, "")
    runs, faults = list(begun.runs), begun.faults
    known = find_prior(folder, prior, nominal_robot(rig), rig.spring_tolerances(), known_parameters(rig))
    films = [read_run(folder / run.log, design, rig, progress) for run in runs]
    for run, film in zip(runs, films, strict=True):  # after an interruption one may be missing
        write_film(folder / run.log, design, film)
    learned = _learn(design, rig, films, known, faults, config, progress) if films else None
    ended = f"all runs are made ({config.runs})"
    while len(runs) < config.runs:
        scene, belief, faults = _what_is_known(known, faults, learned, room_c)
        place = folder / f"run_{len(runs) + 1:02d}"
        log = place / f"{place.name}.mcap"
        plans = PlanConfig(
            seed=config.seed + len(runs),
            samples=config.samples,
            cycles=config.cycles,
            design_file=os.path.relpath(design_file, place),
            scene=scene,
            air_c=room_c if learned is None else None,
        )
        if log.exists():  # the run before was interrupted after it was played
            schedule = ActuationSchedule.load(place / _SCHEDULE)
        else:
            try:
                _require_repaired(faults, runs, current)
                deadline.require(1.0)
                counted = [runs[number - 1] for number in repeatable_runs(runs, faults, current)]
                believed = believed_robots(design, rig, scene, belief)
                schedule = plan_run(
                    design,
                    rig,
                    plans,
                    counted,
                    filmed_walks(films),
                    believed,
                    config,
                    lambda what: progress(what, 0.0),
                )
                deadline.require(schedule.duration)
                ask(len(runs) + 1, schedule)
                deadline.require(schedule.duration)  # a person may have taken long
            except NoGaitError as reason:
                ended = str(reason)
                break
            place.mkdir(parents=True, exist_ok=True)
            if scene is not None:
                scene.save(place / BELIEF)
            schedule.save(place / _SCHEDULE)
            _drive(drive, schedule, log)
        try:
            films.append(read_run(log, design, rig, progress, has_moved=_have_moved(films, current)))
        except InputError:
            _set_aside(log)  # else the same command would fail for ever
            raise
        runs.append(_record(log, design, schedule, films[-1], filmed_walks(films[:-1]), scene))
        # With the faults of earlier runs: those of this one are not known yet.
        _save(folder, Adaptation(tuple(runs), best_run(runs, faults, current), "", (), faults))
        on_run(len(runs), runs[-1])
        write_film(log, design, films[-1])
        learned = _learn(design, rig, films, known, faults, config, progress)
        _report(folder, rig, learned.summarize(runs, current), known, learned.scene)
    if learned is None:
        return Adaptation((), None, ended)
    found = _advise(design, rig, folder, learned.summarize(runs, current, ended), films, learned, config)
    return _report(folder, rig, found, known, learned.scene)


def _what_is_known(
    prior: PrintedScene | None, faults: tuple[Fault, ...], learned: _Learned | None, air_c: float | None
) -> tuple[PrintedScene | None, Belief | None, tuple[Fault, ...]]:
    """What a prior or the films tell of the robot, and its faults. `air_c`: temperature of the air [C]; None:
    that of the rig file or the last film."""
    scene, belief = prior, None
    if learned is not None:
        scene, belief, faults = learned.scene, belief_in_air(learned.belief, air_c), learned.faults
    if scene is not None:
        scene = replace(scene, springs=scene.springs.in_air(air_c))
    return scene, belief, faults


def _moves(film: RobotFilms) -> bool:
    return moves(film.recordings[0])


def _have_moved(films: Sequence[RobotFilms], current_limit_a: float) -> bool:
    """Whether the robot moved in a film with this current limit or a lower one."""
    return any(_moves(film) for film in films if film.nominal.springs.current_limit <= current_limit_a)


class _Learned(NamedTuple):
    """What the films tell."""

    scene: PrintedScene
    belief: Belief
    faults: tuple[Fault, ...]
    heat: SpringHeat | None

    def summarize(self, runs: Sequence[AdaptationRun], current_limit_a: float, ended: str = "") -> Adaptation:
        """The summary after these runs, for the present current limit, without advice."""
        best = best_run(runs, self.faults, current_limit_a)
        return Adaptation(tuple(runs), best, ended, (), self.faults, self.heat)


def _learn(
    design: Design,
    rig: Rig,
    films: Sequence[RobotFilms],
    prior: PrintedScene | None,
    faults: Sequence[Fault],
    config: AdaptationConfig,
    progress: Progress,
) -> _Learned:
    """What all films tell, and the faults that they show; `faults`: those that earlier ones did."""
    scene, belief = believe_films(design, rig, films, prior, config, progress)
    number = len(films)
    earlier = tuple(fault for fault in faults if fault.run < number)
    now = find_faults(number, films[-1], belief, rig.limits.max_temperature_c, rig.tolerances.current)
    heat = believe_heat(belief, films[-1]) if belief.explains and _moves(films[-1]) else None
    return _Learned(scene, belief, earlier + now, heat)


def _advise(
    design: Design,
    rig: Rig,
    folder: Path,
    found: Adaptation,
    films: Sequence[RobotFilms],
    learned: _Learned,
    config: AdaptationConfig,
) -> Adaptation:
    """The summary with advice on the supply for the best run, if there is one and the belief explains the
    films."""
    if found.best is None or not learned.belief.explains:
        return found
    schedule = ActuationSchedule.load(folder / found.runs[found.best - 1].schedule)
    plays = BestRun(schedule, films[found.best - 1])
    advice = advise_supply(design, rig, plays, filmed_walks(films), learned.scene, learned.belief, config)
    return replace(found, advice=advice)


def _require_repaired(faults: Sequence[Fault], runs: Sequence[AdaptationRun], current_limit_a: float) -> None:
    """Raise `NoGaitError` for a fault in the last run that no gait can make up for, and for springs that were
    too hot in any run, until the current is lower than then."""
    for fault in faults:
        if fault.kind in _TO_REPAIR and fault.run == len(runs):
            raise NoGaitError(f"{fault.text}. Repair it, then begin a new folder")
        if fault.kind == _TOO_HOT and current_limit_a >= runs[fault.run - 1].current_limit_a:
            raise NoGaitError(f"run {fault.run}: {fault.text}. With a lower current the same command goes on")


def _require_learnable(design: Design, rig: Rig) -> None:
    """Raise `InputError` for a robot or a rig with which nothing can be learned: before anything is heated,
    not after its first film."""
    _require_table(design)
    _require_markers(design)
    rig.require_own_outputs()


def _require_table(design: Design) -> None:
    if design.printed_terrain is not None:
        raise InputError(
            "the robot stands on a printed ground",
            code="dynamics.terrain",
            expected="a robot on a table: where a ground lies under the robot is not measured",
            remedy="use a design of the same body without printed_terrain",
        )


def _require_markers(design: Design) -> None:
    marks, needed = len(design.marks), DEFAULT_CONFIG.min_markers
    if marks < needed:
        raise InputError(
            "the robot carries too few markers to learn from",
            code="adapt.too-few-marks",
            expected=f"{needed} or more",
            found=str(marks),
            remedy="take a design with more masses on its rear, such as another one of the shortlist",
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


def _record(
    log: Path,
    design: Design,
    schedule: ActuationSchedule,
    films: RobotFilms,
    before: Sequence[FilmedWalk],
    scene: PrintedScene | None,
) -> AdaptationRun:
    """`before`: what was filmed before the run; `scene`: the belief then."""
    (film,) = films.filmed_gaits
    current = films.nominal.springs.current_limit
    folder, mean, deviation = log.parent.name, None, None
    bias, error = (0.0, 0.0) if scene is None else discrepancy(design, scene, before, current)
    if (walk := schedule.predicted.walk) is not None and walk.expected is not None:
        mean = round(walk.expected - bias, 4)
        deviation = round(float(np.hypot(walk.spread_with_falls, error)), 4)
    misfit = None if scene is None else scene.provenance.get(MISFIT)
    return AdaptationRun(
        f"{folder}/{_SCHEDULE}",
        f"{folder}/{log.name}",
        current,
        mean,
        deviation,
        None if misfit is None else round(float(misfit), 4),
        round(film.walked, 4),
        film.upright,
        film.cycles,
        open_run(log, design).impossible_motion or None,
        film.lost_at_s,
    )


def _save(folder: Path, found: Adaptation) -> None:
    """Write the summary, and the schedule of the best run; without one none is left."""
    found.save(folder / _SUMMARY)
    if found.best is None:
        (folder / _SCHEDULE).unlink(missing_ok=True)
    else:
        ActuationSchedule.load(folder / found.runs[found.best - 1].schedule).save(folder / _SCHEDULE)


def _report(
    folder: Path, rig: Rig, found: Adaptation, prior: PrintedScene | None, belief: PrintedScene
) -> Adaptation:
    """Write belief, summary, best schedule and page."""
    belief.save(folder / BELIEF)
    _save(folder, found)
    write_page(folder, nominal_robot(rig), found, prior, belief)
    return found
