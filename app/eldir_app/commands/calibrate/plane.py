"""The command `eldir calibrate plane`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eldir.errors import InputError


def plane(
    source: Annotated[
        str, typer.Argument(help="Folder of pictures, video, log, or camera:0, showing the fixed tags.")
    ],
    *,
    tags: Annotated[
        Path | None, typer.Option(help="Tag file: positions of the fixed tags. A log holds its own.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Plane file to write (JSON).")],
    camera: Annotated[
        Path | None, typer.Option(help="Lens file of the camera, from `eldir calibrate camera`.")
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(
            help="Picture to write (PNG): the first frame with the ground and every 0.1 m drawn in."
        ),
    ] = None,
) -> None:
    """Find the plane of motion from at least four fixed tags: its scale, its tilt and the error.

    Example: eldir calibrate plane pictures/ --tags tags.json --out plane.json --check plane.png
    """
    from itertools import islice

    import numpy as np

    from eldir.core.files import require_ending, require_new, write_bytes
    from eldir.trajectory import Trajectory
    from eldir_hardware.camera.lens import Lens
    from eldir_hardware.camera.plane import TagBoard
    from eldir_hardware.camera.tags import calibrate_plane
    from eldir_hardware.camera.validity import PLANE_DAYS, require_valid, valid_for
    from eldir_hardware.vision.pipeline import overlay
    from eldir_hardware.vision.recording_setup import CALIBRATION_FRAMES, attached_board
    from eldir_hardware.vision.sources import open_source, recorded_at

    require_ending("--check", check, ".png")
    require_new(out, check)
    frames = open_source(source, rate=1.0, seconds=2.0)
    board = attached_board(frames) if tags is None else TagBoard.load(tags)
    if board is None:
        raise InputError(
            f"{source} holds no positions of its tags", code="log.no-tags", remedy="give --tags tags.json"
        )
    images = [image for _, image in islice(frames, CALIBRATION_FRAMES)]
    lens = None
    if camera is not None:
        lens = Lens.load(camera)
        require_valid(lens.provenance, recorded_at(frames), str(camera))
    found = calibrate_plane(images, board, {"source": str(source), **valid_for(PLANE_DAYS)}, lens)
    found.save(out)
    if check is not None:
        nothing = Trajectory((), np.zeros(0), np.zeros((0, 0, 2)))
        write_bytes(check, overlay(images[0], found, nothing))
    scale, change = found.scale
    print(
        f"{out}: {len(found.provenance['tags'])} tags fit within {found.rms_px:.2f} px; "
        f"{1e3 / scale:.3f} mm per pixel, which changes by {100 * change:.1f} % over the picture"
    )
    if "remark" in found.provenance:
        print(f"note: {found.provenance['remark']}")
    if found.tilted:
        print("note: the camera is tilted; point it at the plane of motion at a right angle")
