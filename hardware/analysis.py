"""From logs alone to the motions of a report."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml

from calibration.comparison import CYCLES, Motion
from calibration.null import OtherDesigns, against_others
from calibration.plane import Image, Plane
from calibration.quality import TrackingQuality
from calibration.report import Heating, ReportInput
from calibration.runs import INTACT, Run
from eldir import __version__
from eldir.built import BuiltRobot, build
from eldir.built_parameters import BuiltParameters
from eldir.built_scene import BuiltScene
from eldir.design import Design
from eldir.driving import FINE, drive
from eldir.errors import EldirError, InputError
from eldir.frozen import IntArray
from eldir.knobs import Specimen
from eldir.rollout import simulate
from eldir.sma import SpringState, heat
from eldir.trajectory import Trajectory
from hardware.log.reader import RunLog, read_log
from hardware.null_designs import other_robots
from hardware.rig import Rig
from hardware.schedule import ActuationSchedule
from hardware.vision.pipeline import follow, layout_of, lens_that_came_with, overlay, plane_that_came_with
from hardware.vision.sources import Log, Source

_INTERVAL = 0.05  # of the predicted temperatures [s]
_NULL_CYCLES = 2
_POOR_WALK = 0.3  # body lengths per five cycles below which a prediction is explained
T = TypeVar("T")


@dataclass(frozen=True)
class _Driven:
    """What was driven."""

    design: Design
    schedule: ActuationSchedule
    rig: Rig

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"m{i + 1}" for i in range(len(self.design.marks)))

    @property
    def robot(self) -> BuiltRobot:
        return build(self.design.morphology, ballast=self.design.ballast / 2)  # of one plane

    def motion(self, trajectory: Trajectory) -> Motion:
        """Over the cycles that count."""
        s = self.schedule
        return Motion(trajectory, s.start_of_cycles, s.period_s, s.cycles, self.robot.body_length)


@dataclass(frozen=True)
class Logged(_Driven):
    """What was driven, and the log of it."""

    log: RunLog


@dataclass(frozen=True)
class _Filmed:
    """What the camera saw."""

    motion: Motion
    quality: TrackingQuality
    plane: Plane
    frame: Image
    """At the start of the cycles that count."""


def analyse(
    paths: Path | Sequence[Path],
    design: Design,
    seen: Callable[[int], None] = lambda frames: None,
    scene: BuiltScene | None = None,
) -> ReportInput:
    """Track the frames of one log or several, roll the design out, predict schedules: all that a report
    shows. The first log of the intact robot is compared in full; the others stand beside it.

    With a `scene`, predictions are that robot's, and the nominal one's is shown as what was before."""
    logs = [opened(path, design) for path in ([paths] if isinstance(paths, Path) else paths)]
    for driven in logs:
        if driven.log.frame_count == 0:
            raise InputError(
                f"{driven.log.path} holds no frames", remedy="record with a camera in the rig file"
            )
    specimen = None if scene is None else scene.specimen
    logs.sort(key=lambda d: "variant" in d.design.provenance)
    done = 0
    runs: list[Run] = []
    films: list[_Filmed] = []
    others: OtherDesigns | None = None
    for driven in logs:
        films.append(filmed(driven, _after(done, seen)))
        done += films[-1].quality.frames
        first = not runs
        predicted, *elsewhere = _predicted(driven, other_robots(driven.design) if first else [], specimen)
        runs.append(Run(driven.log.path.name, *_kind(driven.design), films[-1].motion, predicted))
        if first:
            evolved = _evolved(driven)
            own = {"simulated": evolved, "predicted": predicted}
            others = against_others(own, films[-1].motion, elsewhere)
    main, film = logs[0], films[0]
    remarks = [*_remarks(main.schedule), *film.quality.remarks(main.names)]
    if "remark" in film.plane.provenance:
        remarks.append(film.plane.provenance["remark"])
    if runs[0].robot != INTACT:
        remarks.insert(0, f"No log is of the robot as designed: {runs[0].log} is of one {runs[0].robot}.")
    return ReportInput(
        title=f"Simulated, predicted and filmed: {', '.join(run.log for run in runs)}",
        simulated=evolved,
        predicted=runs[0].predicted,
        before=None if scene is None else _predicted(main, [])[0],
        tracked=film.motion,
        heating=_heating(main.log),
        overlay=overlay(film.frame, film.plane, film.motion.trajectory),
        remarks=tuple(remarks),
        provenance={
            "log": ", ".join(run.log for run in runs),
            "rig": f"{main.rig.name} ({main.rig.kind})",
            "schedule": f"{main.schedule.cycles} cycles of {main.schedule.period_s:g} s",
            "frames": ", ".join(str(d.log.frame_count) for d in logs),
            "lens": camera_words(Log(main.log)),
            "plane": plane_words(film.plane),
            "recovered": "; ".join(d.log.recovered for d in logs if d.log.recovered) or "no log had to be",
            "eldir": __version__,
        },
        runs=tuple(runs),
        others=others,
        quality=film.quality,
        frame=film.frame,
        plane=film.plane,
    )


def motions_without_camera(design: Design, schedule: ActuationSchedule, rig: Rig) -> tuple[Motion, Motion]:
    """The evolved motion of the design's marks, and the one predicted for exactly this schedule."""
    driven = _Driven(design, schedule, rig)
    (predicted,) = _predicted(driven, [])
    return _evolved(driven), predicted


def _after(done: int, seen: Callable[[int], None]) -> Callable[[int], None]:
    return lambda frames: seen(done + frames)


def opened(path: Path, design: Design) -> Logged:
    """A log, and what it was recorded with; refused where that was another design."""
    log = read_log(path)
    recorded = _attached(log, "design.json", lambda b: Design.from_json(json.loads(b)))
    if not _is_of(recorded, design):
        raise InputError(
            f"{path} was recorded with another design",
            expected="the design that the log holds as design.json, or one it was made from",
            found=f"another {'body' if recorded.genotype != design.genotype else 'controller or scene'}",
        )
    schedule = _attached(log, "schedule.json", lambda b: ActuationSchedule.from_json(json.loads(b)))
    rig = _attached(log, "rig.yaml", lambda b: Rig.model_validate(yaml.safe_load(b)))
    return Logged(recorded, schedule, rig, log)


def _is_of(recorded: Design, design: Design) -> bool:
    """Whether a log's robot is the design, or the design with a motor or weight changed."""
    if recorded == design:
        return True
    if "variant" not in recorded.provenance or "variant" in design.provenance:
        return False
    without = recorded.provenance["variant"].get("without_motor")
    springs = design.genotype.springs.copy()
    if without is not None:
        body = design.morphology
        springs[body.lattice_springs[body.active][without]] = False
    same_body = np.array_equal(recorded.genotype.triangles, design.genotype.triangles)
    return same_body and np.array_equal(recorded.genotype.springs, springs)


def _kind(design: Design) -> tuple[str, str]:
    """Which robot it is, and the detail."""
    variant = design.provenance.get("variant", {})
    parts, details = [], []
    if "without_motor" in variant:
        parts.append("without a motor")
        details.append(f"without motor {variant['without_motor']}")
    if "ballast" in variant:
        parts.append("with ballast")
        details.append(f"{variant['ballast']['grams']:g} g on mass {variant['ballast']['mass']}")
    return ", ".join(parts) or INTACT, ", ".join(details)


def filmed(driven: Logged, seen: Callable[[int], None]) -> _Filmed:
    """What is seen in a log's frames."""
    source = Log(driven.log)
    plane = plane_that_came_with(source)
    found = follow(source, plane, driven.names, layout_of(driven.design), seen)
    frame = driven.log.frame_from(driven.schedule.start_of_cycles)
    frame = found.last if frame is None else frame
    return _Filmed(driven.motion(found.trajectory), found.quality, plane, frame)


def _evolved(driven: _Driven) -> Motion:
    """The closed-loop rollout: its last five whole cycles of the pattern generators."""
    design = driven.design
    (rollout,) = simulate([design.morphology], [design.controller], design.scene)
    if rollout.status != FINE:
        raise EldirError(f"the design's rollout blew up at step {rollout.status}", remedy="choose another")
    times = np.arange(len(rollout.positions)) * design.scene.dt
    period = 2 * np.pi / design.scene.omega
    cycles = min(CYCLES, int(times[-1] / period))
    # In simulation the ground lies at another height and the body at another place than on the table.
    placed = rollout.positions[:, design.marks] - rollout.positions[0].min(axis=0)
    return Motion(
        Trajectory(driven.names, times, placed),
        float(times[-1] - cycles * period),
        period,
        cycles,
        design.morphology.body_length,
        driven.robot.parameters.scale,
    )


def _predicted(
    driven: _Driven, others: list[tuple[BuiltRobot, IntArray]], specimen: Specimen | None = None
) -> list[Motion]:
    """The nominal robot, or this specimen of it, under exactly this schedule, then those of the others
    that stay whole."""
    schedule, rig = driven.schedule, driven.rig
    built, springs = specimen or (BuiltParameters(), rig.spring_parameters())
    robot = build(driven.design.morphology, built, ballast=driven.design.ballast / 2)
    channels, states = schedule.sampled(_INTERVAL)
    motor_of = {c.channel: c.spring for c in rig.channels}
    motors = int(robot.active.sum())
    # Both faces heat alike in the model; a plane's motor is on while either of its channels is.
    on = np.zeros((len(states), motors), bool)
    for column, channel in enumerate(channels):
        on[:, motor_of[channel]] |= states[:, column]
    lengths = heat(on, _INTERVAL, springs, SpringState.cold(motors, springs)).length
    table = np.concatenate([np.full((1, motors), springs.cold_length), lengths])
    (motion,) = drive([robot], [table], _INTERVAL, free=(springs.cold_length, springs.hot_length))
    if motion.status != FINE:
        raise EldirError("the predicted motion blew up", remedy="choose another design")
    marks = driven.design.marks
    own = driven.motion(Trajectory(driven.names, motion.times, motion.positions[:, marks]))
    if not others:
        return [own]
    # A null needs no more than two cycles: half the time.
    cycles = min(schedule.cycles, _NULL_CYCLES)
    end = int(np.ceil((schedule.start_of_cycles + cycles * schedule.period_s) / _INTERVAL)) + 1
    elsewhere = drive(
        [body for body, _ in others], [table[:end]] * len(others), _INTERVAL,
        free=(springs.cold_length, springs.hot_length),
    )  # fmt: skip
    return [own] + [
        replace(
            own,
            trajectory=Trajectory(driven.names, m.times, m.positions[:, mark[: len(driven.names)]]),
            cycles=cycles,
            body_length=body.body_length,
        )
        for m, (body, mark) in zip(elsewhere, others, strict=True)
        if m.status == FINE
    ]


def _heating(log: RunLog) -> Heating:
    return Heating(
        log.relay_times, log.relays, log.channels, log.temperature_times, log.temperatures, log.springs
    )


def camera_words(source: Source) -> str:
    """How a log's camera was calibrated."""
    lens = lens_that_came_with(source)
    if lens is None:
        return "not calibrated: no lens file in the log; its distortion is as the fixed tags show it"
    low, high = lens.rms_interval_px
    when = lens.provenance.get("made", "at an unknown time")
    error = f"error {lens.rms_px:.2f} px ({low:.2f} to {high:.2f})"
    return f"calibrated {when}, focal length {lens.focal[0]:.1f} px, {error}"


def plane_words(plane: Plane) -> str:
    """Where a plane of motion comes from."""
    made = plane.provenance.get("made")  # those that are found from a log have no date
    how = "from the log's first frames" if made is None else f"calibrated {made}"
    return f"{how}, {len(plane.provenance.get('tags', ()))} tags within {plane.rms_px:.2f} px"


def _remarks(schedule: ActuationSchedule) -> tuple[str, ...]:
    walks = schedule.predicted.get("displacement", {})
    walk = walks.get(schedule.predicted.get("method"), {})
    remarks: tuple[str, ...] = ()
    if walk.get("fell"):
        remarks = (
            f"Of {walk['builds']} builds {walk['fell']} fall over by prediction; the ensemble's mean and "
            "spread are of those that stand.",
        )
    mean = walk.get("mean")
    if mean is None or mean >= _POOR_WALK:
        return remarks
    return (
        *remarks,
        f"The ensemble of builds predicts {mean:+.2f} body lengths per five cycles, less than {_POOR_WALK}: "
        "about one random two-motor design in a hundred walks half a body length; a larger population, "
        "or more generations, gives the build filter more to choose from.",
    )


def _attached(log: RunLog, name: str, read: Callable[[bytes], T]) -> T:
    if name not in log.attachments:
        raise InputError(
            f"{log.path} has no {name}",
            expected="a log of `eldir rig drive` with its design, schedule, rig and tags attached",
            found=", ".join(log.attachments) or "no attachments",
        )
    try:
        return read(log.attachments[name])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{name} in {log.path} is damaged", found=str(error).splitlines()[0]) from None
