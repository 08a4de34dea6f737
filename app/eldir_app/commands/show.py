"""The command `eldir show`: a picture or a video of a design."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from eldir.design import Design

_FRAME_RATE = 25  # [1/s]


def show(
    design: Annotated[Path, typer.Argument(metavar="DESIGN", help="Design file.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Picture (.png) or video (.webm) to write. Default: DESIGN.png."),
    ] = None,
) -> None:
    """Draw a design (.png), or its rollout as a video (.webm).

    Passive springs are grey, motors are orange-red. In the video a motor turns darker when it contracts and
    lighter when it expands. m1 to m5 are the masses that the camera of the rig tracks.

    Example: eldir show design.json --out design.webm
    """
    if out is not None and out.suffix not in (".png", ".webm"):
        raise typer.BadParameter(f"--out: expected a name that ends in .png or .webm, found {out}")
    from eldir.core.files import write_bytes
    from eldir.design import Design
    from eldir.show import picture

    robot = Design.load(design)
    target = out if out is not None else design.with_suffix(".png")
    if target.suffix == ".png":
        write_bytes(target, picture(robot))
    else:
        _write_video(robot, target)
    print(target)


def _write_video(robot: Design, target: Path) -> None:
    from eldir.rollout import simulate
    from eldir.show import frames
    from eldir_app.progress import progress_bar
    from eldir_hardware.images.video import write_webm

    rollout = simulate([robot.morphology], [robot.controller], robot.scene)[0]
    count = int(robot.scene.steps * robot.scene.dt * _FRAME_RATE) + 1
    with progress_bar() as progress:
        film = progress.track(frames(robot, rollout, _FRAME_RATE), total=count, description="drawing")
        write_webm(target, film, _FRAME_RATE)
