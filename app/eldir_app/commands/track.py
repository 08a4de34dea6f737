"""The command `eldir track`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir.errors import EldirError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eldir.core.records import FloatArray
    from eldir.errors import InputError
    from eldir_hardware.camera.plane import Image, Plane
    from eldir_hardware.vision.pipeline import TrackingResult
    from eldir_hardware.vision.sources import CameraDevice, Source

_FILMING_TIME_S = 10.0


def track(
    source: Annotated[
        str,  # a path would lose a slash of http://
        typer.Argument(help="Video file, folder of pictures, log of a run, or a camera such as camera:0."),
    ],
    *,
    out: Annotated[Path, typer.Option(help="Trajectory file to write (JSON).")],
    design: Annotated[
        Path | None,
        typer.Option(help="Design file: it says which masses carry markers. A log contains its own design."),
    ] = None,
    tags: Annotated[
        Path | None,
        typer.Option(
            help="Tag file: positions of the reference tags. The first frames then give the plane of motion."
        ),
    ] = None,
    plane: Annotated[
        Path | None, typer.Option(help="Plane file of `eldir calibrate plane`, instead of --tags.")
    ] = None,
    marks: Annotated[
        int | None, typer.Option(min=1, max=5, help="Number of markers, if no design is given. Default: 5.")
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            min=1e-3, max=1e5, help="Frames per second of a folder of pictures or a video without times."
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=0.1, max=86400.0, help="Filming time for a camera, in seconds. Default: 10."),
    ] = None,
    marker: Annotated[
        str | None,
        typer.Option(
            help="Kind of the markers: discs, aruco or apriltag. Default: what the log's rig file names, or "
            "discs."
        ),
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(help="Picture to write (PNG): the paths of the markers over the last frame."),
    ] = None,
    save_plane: Annotated[
        Path | None, typer.Option(help="Write the calibrated plane to this file (JSON).")
    ] = None,
) -> None:
    """Track the markers m1 to m5 in every frame and write their positions in metres.

    Example: eldir track walk.mp4 --tags tags.json --design design.json --out walk.json --overlay walk.png
    """
    from eldir.core.files import require_ending, require_new
    from eldir_hardware.vision.sources import open_source

    if plane is not None and tags is not None:
        raise typer.BadParameter("give --plane or --tags, not both")
    require_ending("--overlay", overlay, ".png")
    require_new(out, overlay, save_plane)
    frames = open_source(source, rate, _FILMING_TIME_S if seconds is None else seconds)
    if problem := _surplus_option(frames, rate, seconds):
        raise typer.BadParameter(problem)
    layout = _layout(frames, design)
    if marks is not None and layout is not None:
        reason = f"{source} contains its design" if design is None else f"--design {design} is given"
        raise typer.BadParameter(f"--marks is only for films without a design: {reason}; remove it")
    config = _TrackingConfig(_plane(frames, plane, tags), layout, marks, marker)
    filming, result = _track(frames, config)
    ground, on_ground = (None, []) if overlay is None else _ground(frames, design, result)
    _save(result, config, source, out, overlay, save_plane, ground)
    for note in [*_notes(result, config, frames), *on_ground]:
        print(f"note: {note}")
    quality, times = result.quality, result.trajectory.times
    measured = ", ".join(
        f"{name} {100 * share:.1f} %" for name, share in zip(config.names, quality.seen, strict=True)
    )
    print(f"{out}: {len(times)} frames over {times[-1] - times[0]:.1f} s; measured: {measured}")
    if filming is not None and filming.error is not None:
        raise EldirError(f"{out} holds only the first {filming.duration_s:.1f} s of filming: {filming.error}")


@dataclass(frozen=True)
class _TrackingConfig:
    """What is tracked: the plane of motion, and which markers."""

    plane: Plane
    layout: FloatArray | None
    """Places of the marked masses in the design [m]; None without a design."""
    count: int | None
    """Number of markers, if there is no design."""
    kind: str | None
    """Kind of the markers; None: that of the source."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the markers: m1, m2, ..."""
        from eldir_hardware.markers.registration import PALETTE

        number = (self.count or len(PALETTE)) if self.layout is None else len(self.layout)
        return tuple(PALETTE)[:number]


def _track(frames: Source, config: _TrackingConfig) -> tuple[_Filming | None, TrackingResult]:
    """Track the markers with a progress bar."""
    from eldir_app.progress import progress_bar
    from eldir_hardware.markers.registration import require_kind
    from eldir_hardware.vision import pipeline
    from eldir_hardware.vision.recording_setup import read_marker_kind
    from eldir_hardware.vision.sources import CameraDevice, LoggedFrames

    kind = (
        read_marker_kind(frames.attachments, frames.name)
        if config.kind is None
        else require_kind(config.kind)
    )
    total = frames.log.frame_count if isinstance(frames, LoggedFrames) else None
    with progress_bar() as progress:
        task = progress.add_task("tracking the film", total=total)

        def show(frames: int) -> None:
            progress.update(task, completed=frames)

        filming = _Filming(frames) if isinstance(frames, CameraDevice) else None
        result = pipeline.track_frames(
            filming or frames, config.plane, config.names, config.layout, show, kind
        )
    return filming, result


def _save(
    result: TrackingResult,
    config: _TrackingConfig,
    source: str,
    out: Path,
    overlay: Path | None,
    save_plane: Path | None,
    ground: FloatArray | None,
) -> None:
    """Write the trajectory, and the plane and the picture if they are wanted."""
    from eldir.core.files import write_bytes
    from eldir_hardware.vision import pipeline

    provenance = {"source": source, "plane": config.plane.to_json(), "quality": result.quality.to_json()}
    replace(result.trajectory, provenance=provenance).save(out)
    if save_plane is not None:
        config.plane.save(save_plane)
    if overlay is not None:
        write_bytes(
            overlay, pipeline.draw_overlay(result.last_frame, config.plane, result.trajectory, ground)
        )


def _ground(frames: Source, file: Path | None, result: TrackingResult) -> tuple[FloatArray | None, list[str]]:
    """The printed ground in the plane of motion (`PrintedGround.in_plane`), and notes on it; only a log says
    when its run began."""
    from eldir.design import Design
    from eldir_hardware.log.reader import read_attachment
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.vision.printed_ground import NOT_DRAWN, ON_GROUND, predict_ground
    from eldir_hardware.vision.recording_setup import read_attached_design
    from eldir_hardware.vision.sources import LoggedFrames

    design = read_attached_design(frames) if file is None else Design.load(file)
    if design is None or design.printed_terrain is None:
        return None, []
    if not isinstance(frames, LoggedFrames):
        return None, [NOT_DRAWN]
    rig = read_attachment(frames.attachments, frames.name, "rig.yaml", Rig.from_json)
    predicted, path = predict_ground(design, rig), result.trajectory
    ground = None if predicted is None else predicted.in_plane(path.times, path.positions)
    return ground, [NOT_DRAWN if ground is None else ON_GROUND]


def _notes(result: TrackingResult, config: _TrackingConfig, frames: Source) -> list[str]:
    """Notes on the plane, the film and the quality of the tracks."""
    from eldir_hardware.vision.sources import Video

    notes = [config.plane.provenance["remark"]] if "remark" in config.plane.provenance else []
    notes += frames.remarks if isinstance(frames, Video) else []
    return [*notes, *result.quality.remarks(config.names)]


def _surplus_option(frames: Source, rate: float | None, seconds: float | None) -> str:
    """What is wrong about an option that this source cannot use; empty if there is none."""
    from eldir_hardware.vision.sources import CameraDevice, PictureFolder, Video

    if seconds is not None and not isinstance(frames, CameraDevice):
        return f"--seconds is only for cameras, and {frames.name} is not a camera; remove it"
    if rate is not None and (not isinstance(frames, Video | PictureFolder) or frames.has_times):
        return f"--rate is only for pictures without timestamps, and {frames.name} has timestamps; remove it"
    return ""


class _Filming:
    """Frames of a camera until it fails; the frames before the failure are kept."""

    def __init__(self, frames: CameraDevice):
        self._frames = frames
        self.duration_s = 0.0
        self.error: InputError | None = None

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        from eldir.errors import InputError

        has_frames = False
        try:
            for t, image in self._frames:
                has_frames, self.duration_s = True, t
                yield t, image
        except InputError as error:
            if not has_frames:
                raise
            self.error = error


def _plane(frames: Source, plane: Path | None, tags: Path | None) -> Plane:
    from eldir_hardware.camera.lens import require_not_expired
    from eldir_hardware.camera.plane import Plane, TagBoard
    from eldir_hardware.vision import recording_setup
    from eldir_hardware.vision.sources import recording_time

    if plane is not None:
        calibrated = Plane.load(plane)
        require_not_expired(calibrated.provenance, recording_time(frames), str(plane))
        return calibrated
    if tags is not None:
        return recording_setup.calibrate_from_frames(frames, TagBoard.load(tags))
    return recording_setup.find_recorded_plane(frames)


def _layout(frames: Source, design: Path | None) -> FloatArray | None:
    from eldir.design import Design
    from eldir_hardware.vision.recording_setup import marker_layout, read_attached_layout

    return read_attached_layout(frames) if design is None else marker_layout(Design.load(design))
