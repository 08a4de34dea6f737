"""The command `eldir calibrate plane`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir.errors import InputError

if TYPE_CHECKING:
    from eldir_hardware.camera.plane import Image, Plane
    from eldir_hardware.vision.sources import Source


def plane(
    source: Annotated[
        str, typer.Argument(help="Folder of pictures, video, log, or camera:0, showing the reference tags.")
    ],
    *,
    tags: Annotated[
        Path | None, typer.Option(help="Tag file: positions of the reference tags. A log contains its own.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Plane file to write (JSON).")],
    camera: Annotated[
        Path | None,
        typer.Option(help="Lens file of the camera, from `eldir calibrate camera`. A log contains its own."),
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(
            help="Picture to write (PNG): the first frame with the ground and every 0.1 m drawn in."
        ),
    ] = None,
) -> None:
    """Find the plane of motion from at least four reference tags: its scale, its tilt and the error.

    Example: eldir calibrate plane pictures/ --tags tags.json --out plane.json --check plane.png
    """
    from eldir.core.files import require_ending, require_new
    from eldir_hardware.vision.sources import open_source

    require_ending("--check", check, ".png")
    require_new(out, check)
    images, fit = _calibrate(open_source(source, rate=1.0, seconds=2.0), source, tags, camera)
    fit.save(out)
    if check is not None:
        _draw_check(images[0], fit, check)
    scale, change = fit.scale
    print(
        f"{out}: {len(fit.provenance['tags'])} tags fit within {fit.rms_px:.2f} px; "
        f"{1e3 / scale:.3f} mm per pixel, which changes by {100 * change:.1f} % over the picture"
    )
    if "remark" in fit.provenance:
        print(f"note: {fit.provenance['remark']}")
    if fit.is_tilted:
        print("note: the camera is tilted; point it at the plane of motion at a right angle")


def _calibrate(
    frames: Source, name: str, tags: Path | None, camera: Path | None
) -> tuple[list[Image], Plane]:
    """The first pictures, and the plane fitted to their tags."""
    from itertools import islice

    from eldir_hardware.camera.lens import PLANE_VALIDITY_DAYS, Lens, require_not_expired, validity_period
    from eldir_hardware.camera.plane import TagBoard
    from eldir_hardware.camera.plane_fit import calibrate_plane
    from eldir_hardware.vision.recording_setup import (
        CALIBRATION_FRAMES,
        calibrate_with_recorded_lens,
        find_recorded_lens,
        read_attached_board,
    )
    from eldir_hardware.vision.sources import recording_time

    board = read_attached_board(frames) if tags is None else TagBoard.load(tags)
    if board is None:
        raise InputError(
            f"{name} contains no positions of reference tags",
            code="log.no-tags",
            remedy="give --tags tags.json",
        )
    images = [image for _, image in islice(frames, CALIBRATION_FRAMES)]
    provenance = {"source": name, **validity_period(PLANE_VALIDITY_DAYS)}
    if camera is None:
        recorded = find_recorded_lens(frames)
        return images, calibrate_with_recorded_lens(images, board, provenance, recorded)
    lens = Lens.load(camera)
    require_not_expired(lens.provenance, recording_time(frames), str(camera))
    return images, calibrate_plane(images, board, provenance, lens)


def _draw_check(image: Image, plane: Plane, out: Path) -> None:
    """Draw the ground and a grid over a picture."""
    import numpy as np

    from eldir.core.files import write_bytes
    from eldir.trajectory import Trajectory
    from eldir_hardware.vision.pipeline import draw_overlay

    empty = Trajectory((), np.zeros(0), np.zeros((0, 0, 2)))
    write_bytes(out, draw_overlay(image, plane, empty))
