"""From logs to the content of a report: filmed motions, predictions, remarks."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from eldir.built.samples import SAMPLES
from eldir.built.scene import PrintedScene
from eldir.built.walking import describe_doubt
from eldir.core.version import __version__
from eldir.core.worker_process import WorkerProcess
from eldir.design import Design, Variant
from eldir.errors import InputError
from eldir.parameters.wiring import select_motors
from eldir_calibration.comparison.departure import (
    describe_departure,
    describe_lost_cycles,
    find_robot_loss,
    measure_departure,
    observe_standing,
    require_whole_cycle,
)
from eldir_calibration.comparison.film import ground_in_film, render_film
from eldir_calibration.comparison.predictions import PredictedMotions, predict_runs
from eldir_calibration.comparison.recorded_run import LoggedRun, RecordedRun, open_runs
from eldir_calibration.report.comparison import Motion
from eldir_calibration.report.controls import INTACT, FilmedRun, compare_with_others
from eldir_calibration.report.numbers import OutOfPlaneNumbers
from eldir_calibration.report.page import HeatingRecord, ReportInput
from eldir_calibration.report.verdict import RobotLoss
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.log.mcap_file import fingerprint
from eldir_hardware.safety.compatibility import compare_wiring, packet_wiring
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.vision.pipeline import draw_overlay, track_frames
from eldir_hardware.vision.printed_ground import NOT_DRAWN, ON_GROUND
from eldir_hardware.vision.recording_setup import (
    REPORTED_KEY,
    find_recorded_lens,
    find_recorded_plane,
    marker_layout,
)
from eldir_hardware.vision.sources import LoggedFrames, Source
from eldir_hardware.vision.tracking_quality import TrackingQuality

_ON_GROUND = (
    "The robot walks on a printed ground, and so do its predictions. {} The walk is that along the table, "
    "not along a slope."
)
_MIN_WALK = 0.3  # below this prediction the report explains it [body lengths per five cycles]


@dataclass(frozen=True)
class TrackedRun:
    """The filmed motion of one log."""

    motion: Motion
    quality: TrackingQuality
    plane: Plane
    frame: Image
    """The frame at the start of the cycles that count."""
    departure: OutOfPlaneNumbers | None = None
    """How far the robot was out of its plane; None if unknown."""
    loss: RobotLoss | None = None
    """When the robot fell, or all its markers vanished for good; None where they did not."""


def prepare_report(
    paths: Path | Sequence[Path],
    design: Design,
    worker: WorkerProcess,
    progress: Callable[[int, int], None] = lambda frames, total: None,
    scene: PrintedScene | None = None,
    samples: int = SAMPLES,
) -> ReportInput:
    """The content of a report on one log or several. This process tracks the frames; meanwhile `worker`
    simulates the design and predicts the schedules. The first log of the intact robot is compared in full,
    the others stand beside it.

    With a `scene`, the identified robot is predicted; the prediction of the nominal robot is shown as
    "before". `samples`: of the first log's robot. `progress` is called with the number of frames tracked so
    far, and of those in all logs. A log without frames raises `InputError`.
    """
    runs = _open_filmed_runs([paths] if isinstance(paths, Path) else paths, design)
    worker.begin(predict_runs, [run.without_log() for run in runs], scene, samples)
    tracked: list[TrackedRun] = []
    done, total = 0, sum(run.log.frame_count for run in runs)
    for run in runs:
        tracked.append(track_run(run, _offset_progress(done, total, progress)))
        done += tracked[-1].quality.frames
    progress(total, total)  # duplicates are not tracked
    predictions: PredictedMotions = worker.value()
    filmed = tuple(
        FilmedRun(
            run.log.path.name,
            *run.kind,
            film.motion,
            _truncate(predicted, film.motion),
            fingerprint(run.log.path),
            loss=film.loss,
            film_error=0.0 if film.departure is None else film.departure.certain_walk_error,
            other_heating=run.describe_other_heating(runs[0]),
        )
        for run, film, predicted in zip(runs, tracked, predictions.own, strict=True)
    )
    main, film = runs[0], tracked[0]
    own = {"simulated": predictions.evolved, "predicted": filmed[0].predicted}
    ground = ground_in_film(film.motion, predictions.body)
    return ReportInput(
        title=f"Learned, predicted and filmed: {', '.join(run.log for run in filmed)}",
        simulated=predictions.evolved,
        predicted=filmed[0].predicted,
        before=predictions.before and _truncate(predictions.before, film.motion),
        no_test="" if scene is None else _describe_fit(scene, filmed[0]),
        tracked=film.motion,
        heating=_heating(main),
        overlay=draw_overlay(film.frame, film.plane, film.motion.trajectory, ground),
        remarks=_remarks(runs, tracked, filmed, scene, has_ground=ground is not None),
        provenance=_provenance(runs, film.plane, scene),
        runs=filmed,
        others=compare_with_others(own, film.motion, predictions.others),
        quality=film.quality,
        departure=film.departure,
        frame=film.frame,
        plane=film.plane,
        samples=predictions.samples(film.motion.cycles),
        film=render_film(main.log, film.plane, film.motion, predictions.body),
        wiring=select_motors(main.rig.channels, main.design.morphology.motors),
    )


def _open_filmed_runs(paths: Sequence[Path], design: Design) -> list[LoggedRun]:
    """The logs, those of the intact robot first. Raises `InputError` for a log without frames."""
    runs = open_runs(paths, design)
    for run in runs:
        if run.log.frame_count == 0:
            raise InputError(
                f"{run.log.path} holds no frames",
                code="log.no-frames",
                remedy="record with a camera in the rig file",
            )
    return sorted(runs, key=lambda run: run.design.variant != Variant())


def _remarks(
    runs: Sequence[LoggedRun],
    tracked: Sequence[TrackedRun],
    filmed: Sequence[FilmedRun],
    scene: PrintedScene | None,
    has_ground: bool,
) -> tuple[str, ...]:
    """Remarks on the schedule, the tracking, incomplete logs and the plane of motion, and which further films
    the scene was identified from; of the first film the verdict says it."""
    main, first = runs[0], filmed[0]
    remarks = [*_schedule_remarks(main.schedule)]
    for run, one in zip(runs, tracked, strict=True):
        about_robot = describe_lost_cycles(one.loss), describe_departure(one.departure)
        remarks += _name_log([*one.quality.remarks(run.names), *about_robot], run, runs)
    remarks += [
        text
        for run, one in zip(runs, tracked, strict=True)
        if (text := run.describe_missing_cycles(one.motion.cycles))
    ]
    remarks += [
        f"The walk in {run.log.path.name} is that of {one.motion.known_cycles} of {one.motion.cycles} "
        "cycles: no marker was seen at both ends of the others."
        for run, one in zip(runs, tracked, strict=True)
        if one.motion.known_cycles < one.motion.cycles
    ]
    remarks += [
        f"{run.log} was heated otherwise than {first.log}, with {run.other_heating}: their walks are neither "
        "averaged nor compared."
        for run in filmed
        if run.other_heating
    ]
    remarks += [
        f"The walk in {run.log.path.name} is not possible in reality: {run.impossible_motion}."
        for run in runs
        if run.impossible_motion
    ]
    remarks += [
        f"{run.log}: {reason[0].upper()}{reason[1:]}."
        for run in filmed[1:]
        if scene is not None and (reason := _describe_fit(scene, run))
    ]
    if main.design.parts_remark:
        remarks.append(main.design.parts_remark)
    if main.design.printed_terrain is not None:
        remarks.append(_ON_GROUND.format(ON_GROUND if has_ground else NOT_DRAWN))
    for run, one in zip(runs, tracked, strict=True):
        remarks += _name_log([one.plane.provenance.get("remark", "")], run, runs)
    if first.robot != INTACT:
        remarks.insert(0, f"No log is of the robot as designed; {first.log} is of one {first.robot}.")
    return tuple(remarks)


def _name_log(remarks: Sequence[str], run: LoggedRun, runs: Sequence[LoggedRun]) -> list[str]:
    """The remarks that are not empty; of several logs with the name of their log."""
    name = "" if len(runs) == 1 else f"{run.log.path.name}: "
    return [f"{name}{remark}" for remark in remarks if remark]


def _describe_fit(scene: PrintedScene, run: FilmedRun) -> str:
    """Why a film does not test an identified robot: the robot was identified from it. Empty if it does.
    Scenes of older versions have no fingerprints of their logs, but names."""
    digests = scene.provenance.get("fingerprints")
    if digests is None and run.log in scene.provenance.get("logs", ()):
        return "a film of this name was used for the identification, so this may be no test"
    if run.fingerprint in (digests or ()):
        return "this film was used for the identification, so this is no test"
    return ""


def _provenance(runs: Sequence[LoggedRun], plane: Plane, scene: PrintedScene | None) -> dict[str, str]:
    main = runs[0]
    return {
        "log": ", ".join(run.log.path.name for run in runs),
        "rig": f"{main.rig.name} ({main.rig.kind}{main.physics_note})",
        "measured": str(main.measured),
        "wiring": _describe_wiring(main),
        "schedule": f"{main.schedule.cycles} cycles of {main.schedule.period_s:g} s",
        "frames": ", ".join(str(run.log.frame_count) for run in runs),
        "lens": describe_camera(LoggedFrames(main.log)),
        "plane": describe_plane(plane),
        **({} if scene is None else {"scene": _describe_scene(scene)}),
        "recovered": "; ".join(r.log.recovered for r in runs if r.log.recovered) or "none of the logs",
        "eldir": __version__,
    }


def _describe_scene(scene: PrintedScene) -> str:
    """From which logs a robot was identified, and the SHA-256 of its file as this version
    writes it."""
    logs = ", ".join(scene.provenance.get("logs", ())) or "unknown logs"
    return f"identified from {logs}; SHA-256 {hashlib.sha256(scene.to_text().encode()).hexdigest()}"


def _truncate(predicted: Motion, tracked: Motion) -> Motion:
    """The prediction over as many cycles as the camera saw."""
    return replace(predicted, cycles=min(predicted.cycles, tracked.cycles))


def _offset_progress(done: int, total: int, progress: Callable[[int, int], None]) -> Callable[[int], None]:
    return lambda frames: progress(done + frames, total)


def track_run(run: LoggedRun, progress: Callable[[int], None], *, through_falls: bool = False) -> TrackedRun:
    """Tracks the frames of a log; `progress` is called with the number of frames so far. Only cycles count
    that ended before the robot fell or got out of sight. `through_falls`: a fall with all markers in
    sight is not looked for, and cycles after it count too."""
    source = LoggedFrames(run.log)
    plane = find_recorded_plane(source)
    found = track_frames(source, plane, run.names, marker_layout(run.design), progress, run.rig.marker)
    frame = run.log.frame_from(run.schedule.start_of_cycles)
    frame = found.last_frame if frame is None else frame
    lens = find_recorded_lens(source)
    standing = observe_standing(found, run.design, plane, None if lens is None else float(lens.focal_px[0]))
    s = run.schedule
    loss = find_robot_loss(standing, None if through_falls else run.robot.positions[run.design.marks])
    require_whole_cycle(loss, s.start_of_cycles + s.period_s, str(run.log.path))
    motion = run.motion(standing.trajectory)
    if loss is not None:
        whole = int((loss.time_s - s.start_of_cycles) / s.period_s)
        motion = replace(motion, cycles=min(motion.cycles, whole))
    departure = measure_departure(standing, motion)
    return TrackedRun(motion, found.quality, plane, frame, departure, loss)


def _describe_wiring(run: RecordedRun) -> str:
    """Which channel heated which spring, and whether that is the wiring of a packet."""
    packet = packet_wiring(None, run.design.morphology.motors, run.rig)
    wired = select_motors(run.rig.channels, run.design.morphology.motors)
    channels = ", ".join(f"{c.channel} {c.spring_text}" for c in wired)
    differs = compare_wiring(run.rig, packet)
    return f"{channels}; {f'not as {packet.source}: {differs}' if differs else f'as {packet.source}'}"


def _heating(run: LoggedRun) -> HeatingRecord:
    log = run.log
    return HeatingRecord(
        log.relay_times,
        log.relays,
        log.channels,
        log.temperature_times,
        log.temperatures,
        log.springs,
        run.rig.limits.max_temperature_c,
    )


def describe_camera(source: Source) -> str:
    """Description of how the camera of a log was calibrated."""
    lens = find_recorded_lens(source)
    if lens is None:
        return "not calibrated: no lens file in the log; the distortion is found from the reference tags"
    focal = f"focal length {lens.focal_px[0]:.1f} px"
    if reported := lens.provenance.get(REPORTED_KEY):
        return f"calibrated, {focal}, as {reported} has it; error unknown"
    low, high = lens.rms_interval_px
    when = lens.provenance.get("made", "at an unknown time")
    error = f"error {lens.rms_px:.2f} px ({low:.2f} to {high:.2f})"
    return f"calibrated {when}, {focal}, {error}"


def describe_plane(plane: Plane) -> str:
    """Description of how a plane of motion was found."""
    made = plane.provenance.get("made")  # those that are found from a log have no date
    how = "from the log's first frames" if made is None else f"calibrated {made}"
    return f"{how}, {len(plane.provenance.get('tags', ()))} tags within {plane.rms_px:.2f} px"


def _schedule_remarks(schedule: ActuationSchedule) -> tuple[str, ...]:
    walk = schedule.predicted.walk
    remarks: tuple[str, ...] = ()
    if walk is None:
        return remarks
    if walk.fell:
        remarks = (
            f"{walk.fell} of {walk.samples} simulated samples of this robot fall over or fold; mean and "
            "spread are those of the samples that stand.",
        )
    if ties := describe_doubt(walk.tie_share):
        remarks = (*remarks, f"{ties[0].upper()}{ties[1:]}.")
    mean = walk.mean
    if mean is None or max(mean, mean if walk.filmed is None else walk.filmed) >= _MIN_WALK:
        return remarks
    return (
        *remarks,
        f"The samples walk only {mean:+.2f} body lengths per five cycles on average (less than "
        f"{_MIN_WALK}). About one random two-motor design in a hundred walks half a body length; a larger "
        "population or more generations give the build filter more designs to choose from.",
    )
