"""The command `eldir track`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eldir.core.records import FloatArray
    from eldir.errors import InputError
    from eldir_hardware.camera.plane import Image, Plane
    from eldir_hardware.vision.live import CameraDevice
    from eldir_hardware.vision.sources import Source

_FILMED_S = 10.0


def track(
    source: Annotated[
        str,  # a path would lose a slash of http://
        typer.Argument(help="Video file, folder of pictures, log of a run, or a camera such as camera:0."),
    ],
    *,
    out: Annotated[Path, typer.Option(help="Trajectory file to write (JSON).")],
    design: Annotated[
        Path | None,
        typer.Option(help="Design file: it says which masses carry marks. A log contains its own design."),
    ] = None,
    tags: Annotated[
        Path | None,
        typer.Option(
            help="File with the places of the fixed tags. The first frames then give the plane of motion."
        ),
    ] = None,
    plane: Annotated[
        Path | None, typer.Option(help="File of a calibrated plane of motion, instead of --tags.")
    ] = None,
    marks: Annotated[
        int | None, typer.Option(min=1, max=5, help="Number of marks, if no design is given. Default: 5.")
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
        Path | None, typer.Option(help="Picture to write (PNG): the paths of the marks over the last frame.")
    ] = None,
    save_plane: Annotated[
        Path | None, typer.Option(help="Write the calibrated plane to this file (JSON).")
    ] = None,
) -> None:
    """Find the marks m1 to m5 in every frame and write their positions in metres.

    Example: eldir track walk.mp4 --tags tags.json --design design.json --out walk.json --overlay walk.png
    """
    from rich.progress import SpinnerColumn, TextColumn

    from eldir.core.files import require_ending, require_new, write_bytes
    from eldir.errors import EldirError
    from eldir_app.terminal.progress import bar
    from eldir_hardware.markers.mark_sheet import PALETTE
    from eldir_hardware.markers.registration import require_kind
    from eldir_hardware.vision import pipeline
    from eldir_hardware.vision.live import CameraDevice
    from eldir_hardware.vision.recording_setup import attached_marker
    from eldir_hardware.vision.sources import Video, open_source

    if plane is not None and tags is not None:
        raise typer.BadParameter("give --plane or --tags, not both")
    require_ending("--overlay", overlay, ".png")
    require_new(out, overlay, save_plane)
    frames = open_source(source, rate, _FILMED_S if seconds is None else seconds)
    if wrong := _without_effect(frames, rate, seconds):
        raise typer.BadParameter(wrong)
    layout = _layout(frames, design)
    if marks is not None and layout is not None:
        whose = f"{source} contains its design" if design is None else str(design)
        raise typer.BadParameter(f"--marks counts only without a design: {whose}; remove it")
    found = _plane(frames, plane, tags)
    names = tuple(PALETTE)[: (marks or len(PALETTE)) if layout is None else len(layout)]
    columns = (SpinnerColumn(), TextColumn("{task.completed} frames"))
    with bar(*columns) as progress:
        task = progress.add_task("", total=None)
        filming = _Filming(frames) if isinstance(frames, CameraDevice) else None
        followed = pipeline.follow(
            filming or frames,
            found,
            names,
            layout,
            lambda n: progress.update(task, completed=n),
            attached_marker(frames) if marker is None else require_kind(marker),
        )
    trajectory, quality = followed.trajectory, followed.quality
    provenance = {"source": str(source), "plane": found.to_json(), "quality": quality.to_json()}
    replace(trajectory, provenance=provenance).save(out)
    if save_plane is not None:
        found.save(save_plane)
    if overlay is not None:
        write_bytes(overlay, pipeline.overlay(followed.last, found, trajectory))
    remarks = [found.provenance["remark"]] if "remark" in found.provenance else []
    remarks += frames.remarks if isinstance(frames, Video) else []
    for remark in [*remarks, *quality.remarks(names)]:
        print(f"note: {remark}")
    measured = ", ".join(f"{name} {100 * s:.1f} %" for name, s in zip(names, quality.seen, strict=True))
    span = trajectory.times[-1] - trajectory.times[0]
    print(f"{out}: {len(trajectory.times)} frames over {span:.1f} s; measured: {measured}")
    if filming is not None and filming.error is not None:
        raise EldirError(f"{out} holds only the first {filming.lasted_s:.1f} s of filming: {filming.error}")


def _without_effect(frames: Source, rate: float | None, seconds: float | None) -> str:
    """The line about an option that this source has no use for; empty where there is none."""
    from eldir_hardware.vision.live import CameraDevice
    from eldir_hardware.vision.sources import Folder, Video

    if seconds is not None and not isinstance(frames, CameraDevice):
        return f"--seconds counts only for a camera, and {frames.name} is none; remove it"
    if rate is not None and (not isinstance(frames, Video | Folder) or frames.has_times):
        return f"--rate counts only for pictures without timestamps, and {frames.name} has them; remove it"
    return ""


class _Filming:
    """A camera's frames up to where it gives no more; what came before is kept."""

    def __init__(self, frames: CameraDevice):
        self._frames = frames
        self.lasted_s = 0.0
        self.error: InputError | None = None

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        from eldir.errors import InputError

        filmed = False
        try:
            for t, image in self._frames:
                filmed, self.lasted_s = True, t
                yield t, image
        except InputError as error:
            if not filmed:
                raise
            self.error = error


def _plane(frames: Source, plane: Path | None, tags: Path | None) -> Plane:
    from eldir_hardware.camera.plane import Plane, TagBoard
    from eldir_hardware.camera.validity import require_valid
    from eldir_hardware.vision import recording_setup
    from eldir_hardware.vision.sources import recorded_at

    if plane is not None:
        known = Plane.load(plane)
        require_valid(known.provenance, recorded_at(frames), str(plane))
        return known
    if tags is not None:
        return recording_setup.plane_from_frames(frames, TagBoard.load(tags))
    return recording_setup.recorded_plane(frames)


def _layout(frames: Source, design: Path | None) -> FloatArray | None:
    from eldir.design import Design
    from eldir_hardware.vision.recording_setup import attached_layout, layout_of

    return attached_layout(frames) if design is None else layout_of(Design.load(design))
