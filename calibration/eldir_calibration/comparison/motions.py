"""From logs to the content of a report: filmed motions, predictions, remarks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from eldir.built.scene import BuiltScene
from eldir.built.walking import describe_ties
from eldir.core.version import __version__
from eldir.core.worker_process import WorkerProcess
from eldir.design import Design, Variant
from eldir.errors import InputError
from eldir.parameters.wiring import for_motors
from eldir_calibration.comparison.film import film_of
from eldir_calibration.comparison.predictions import SAMPLES, Predicted, predict_runs
from eldir_calibration.comparison.recorded_run import LoggedRun, RecordedRun, open_runs
from eldir_calibration.report.comparison import Motion
from eldir_calibration.report.null_comparison import against_others
from eldir_calibration.report.page import Heating, ReportInput
from eldir_calibration.report.runs import INTACT, FilmedRun
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.log.fingerprint import fingerprint
from eldir_hardware.log.reader import RunLog
from eldir_hardware.rig.packet_wiring import packet_of, wiring_note
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.vision.pipeline import follow, overlay
from eldir_hardware.vision.recording_setup import attached_lens, layout_of, recorded_plane
from eldir_hardware.vision.sources import LoggedFrames, Source
from eldir_hardware.vision.tracking_quality import TrackingQuality

_POOR_WALK = 0.3  # below this prediction the report explains it [body lengths per five cycles]


@dataclass(frozen=True)
class _Filmed:
    """The filmed motion of one log."""

    motion: Motion
    quality: TrackingQuality
    plane: Plane
    frame: Image
    """The frame at the start of the cycles that count."""


def report_content(
    paths: Path | Sequence[Path],
    design: Design,
    worker: WorkerProcess,
    progress: Callable[[int], None] = lambda frames: None,
    scene: BuiltScene | None = None,
    samples: int = SAMPLES,
) -> ReportInput:
    """The content of a report on one log or several. This process tracks the frames; meanwhile `worker`
    simulates the design and predicts the schedules. The first log of the intact robot is compared in full,
    the others stand beside it.

    With a `scene`, the identified robot is predicted; the prediction of the nominal robot is shown as
    "before". `samples`: of the first log's robot. `progress` is called with the number of frames tracked so
    far. A log without frames raises `InputError`.
    """
    logs = open_runs([paths] if isinstance(paths, Path) else paths, design)
    for run in logs:
        if run.log.frame_count == 0:
            raise InputError(
                f"{run.log.path} holds no frames",
                code="log.no-frames",
                remedy="record with a camera in the rig file",
            )
    logs.sort(key=lambda d: d.design.variant != Variant())
    without_logs = [RecordedRun(d.design, d.schedule, d.rig) for d in logs]
    worker.begin(predict_runs, without_logs, scene, samples)
    films: list[_Filmed] = []
    done = 0
    for run in logs:
        films.append(filmed(run, _after(done, progress)))
        done += films[-1].quality.frames
    predictions: Predicted = worker.value()
    runs = [
        FilmedRun(
            run.log.path.name,
            *run.kind,
            film.motion,
            _as_long(predicted, film.motion),
            fingerprint(run.log.path),
        )
        for run, film, predicted in zip(logs, films, predictions.own, strict=True)
    ]
    main, film = logs[0], films[0]
    own = {"simulated": predictions.evolved, "predicted": runs[0].predicted}
    remarks = [*_remarks(main.schedule), *film.quality.remarks(main.names)]
    remarks += [
        f"{d.log.path.name} holds {f.motion.cycles} of {d.schedule.cycles} cycles that count; {d.ending}."
        for d, f in zip(logs, films, strict=True)
        if f.motion.cycles < d.schedule.cycles
    ]
    if "remark" in film.plane.provenance:
        remarks.append(film.plane.provenance["remark"])
    if runs[0].robot != INTACT:
        remarks.insert(0, f"No log is of the robot as designed; {runs[0].log} is of one {runs[0].robot}.")
    return ReportInput(
        title=f"Simulated, predicted and filmed: {', '.join(run.log for run in runs)}",
        simulated=predictions.evolved,
        predicted=runs[0].predicted,
        before=predictions.before and _as_long(predictions.before, film.motion),
        tracked=film.motion,
        heating=_heating(main.log),
        overlay=overlay(film.frame, film.plane, film.motion.trajectory),
        remarks=tuple(remarks),
        provenance={
            "log": ", ".join(run.log for run in runs),
            "rig": f"{main.rig.name} ({main.rig.kind}{main.moved_by})",
            "wiring": _wiring_words(main),
            "schedule": f"{main.schedule.cycles} cycles of {main.schedule.period_s:g} s",
            "frames": ", ".join(str(d.log.frame_count) for d in logs),
            "lens": camera_words(LoggedFrames(main.log)),
            "plane": plane_words(film.plane),
            "recovered": "; ".join(d.log.recovered for d in logs if d.log.recovered) or "none of the logs",
            "eldir": __version__,
        },
        runs=tuple(runs),
        others=against_others(own, film.motion, predictions.others),
        quality=film.quality,
        frame=film.frame,
        plane=film.plane,
        samples=predictions.samples,
        film=film_of(main.log, film.plane, film.motion, predictions.body),
        wiring=for_motors(main.rig.channels, main.design.morphology.motors),
    )


def _as_long(predicted: Motion, filmed: Motion) -> Motion:
    """The prediction over as many cycles as the camera saw."""
    return replace(predicted, cycles=min(predicted.cycles, filmed.cycles))


def _after(done: int, progress: Callable[[int], None]) -> Callable[[int], None]:
    return lambda frames: progress(done + frames)


def filmed(run: LoggedRun, progress: Callable[[int], None]) -> _Filmed:
    """Tracks the frames of a log; `progress` is called with the number of frames so far."""
    source = LoggedFrames(run.log)
    plane = recorded_plane(source)
    found = follow(source, plane, run.names, layout_of(run.design), progress, run.rig.marker)
    frame = run.log.frame_from(run.schedule.start_of_cycles)
    frame = found.last if frame is None else frame
    return _Filmed(run.motion(found.trajectory), found.quality, plane, frame)


def _wiring_words(run: RecordedRun) -> str:
    """Which channel heated which spring, and whether that is the wiring of a packet."""
    packet = packet_of(None, run.design.morphology.motors)
    wired = for_motors(run.rig.channels, run.design.morphology.motors)
    channels = ", ".join(f"{c.channel} spring {c.spring} {c.face}" for c in wired)
    differs = wiring_note(run.rig, packet)
    return f"{channels}; {f'not as {packet.source}: {differs}' if differs else f'as {packet.source}'}"


def _heating(log: RunLog) -> Heating:
    return Heating(
        log.relay_times, log.relays, log.channels, log.temperature_times, log.temperatures, log.springs
    )


def camera_words(source: Source) -> str:
    """Description of how the camera of a log was calibrated."""
    lens = attached_lens(source)
    if lens is None:
        return "not calibrated: no lens file in the log; the distortion is found from the fixed tags"
    low, high = lens.rms_interval_px
    when = lens.provenance.get("made", "at an unknown time")
    error = f"error {lens.rms_px:.2f} px ({low:.2f} to {high:.2f})"
    return f"calibrated {when}, focal length {lens.focal_px[0]:.1f} px, {error}"


def plane_words(plane: Plane) -> str:
    """Description of how a plane of motion was found."""
    made = plane.provenance.get("made")  # those that are found from a log have no date
    how = "from the log's first frames" if made is None else f"calibrated {made}"
    return f"{how}, {len(plane.provenance.get('tags', ()))} tags within {plane.rms_px:.2f} px"


def _remarks(schedule: ActuationSchedule) -> tuple[str, ...]:
    walk = schedule.predicted.walk
    remarks: tuple[str, ...] = ()
    if walk is None:
        return remarks
    if walk.fell:
        remarks = (
            f"{walk.fell} of {walk.samples} simulated samples of this robot fall over or fold; mean and "
            "spread are those of the samples that stand.",
        )
    if walk.tie_share is not None:
        ties = describe_ties(walk.tie_share)
        remarks = (*remarks, f"{ties[0].upper()}{ties[1:]}.")
    mean = walk.mean
    if mean is None or max(mean, mean if walk.filmed is None else walk.filmed) >= _POOR_WALK:
        return remarks
    return (
        *remarks,
        f"The samples walk only {mean:+.2f} body lengths per five cycles on average (less than "
        f"{_POOR_WALK}). About one random two-motor design in a hundred walks half a body length; a larger "
        "population or more generations give the build filter more designs to choose from.",
    )
