"""The command `eldir gait`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer


def gait(
    design: Annotated[Path, typer.Argument(help="Design file.")],
    rig: Annotated[Path, typer.Option(help="The rig file: springs, supply, limits, channels.")],
    out: Annotated[Path, typer.Option(help="Schedule to write, JSON.")],
    imitate: Annotated[
        bool, typer.Option("--imitate", help="Copy the phases of the closed loop, as the paper did.")
    ] = False,
    picture: Annotated[Path | None, typer.Option(help="Picture of a cycle to write, PNG.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the builds in the ensemble.")] = 0,
    scene: Annotated[
        Path | None, typer.Option(help="The robot as films showed it, from `eldir calibrate dynamics`.")
    ] = None,
) -> None:
    """Turn a design's behaviour into a heating schedule for a rig, and predict how far it walks.

    By default phases, period and duty of the motors are searched in the built scene: copied from the
    controller they go forward only by chance. With --scene a gait that the camera saw walking is kept unless
    another is better beyond doubt.

    Example: eldir gait design.json --rig rig.yaml --out schedule.json
    """
    from rich.console import Console

    from eldir.built.scene import BuiltScene
    from eldir.core.files import require_new, write_bytes
    from eldir.design import Design
    from hardware.planning.heat_preview import in_words
    from hardware.planning.heat_preview import picture as draw
    from hardware.planning.plan import plan
    from hardware.planning.precision import remark
    from hardware.rig.configuration import Rig

    require_new(out, picture)
    robot, bench = Design.load(design), Rig.load(rig)
    known = None if scene is None else BuiltScene.load(scene)
    with Console(stderr=True).status("driving the built robot through all phases"):
        named = os.path.relpath(design, out.parent)
        schedule = plan(robot, bench, imitate=imitate, seed=seed, design_file=named, scene=known)
    schedule.save(out)
    if picture is not None:
        write_bytes(picture, draw(schedule))
    for method, walk in schedule.predicted.displacement.items():
        chosen = "*" if method == schedule.predicted.method else " "
        typer.echo(f"{chosen} {method}: {'; '.join(in_words(walk))}")
    if schedule.predicted.choice is not None:
        typer.echo(schedule.predicted.choice)
    if known is not None and not known.model_fits:
        typer.echo(f"note: no value in {scene} is known: its model does not fit, or not for sure")
    if note := remark(schedule, bench):
        typer.echo(f"note: {note}")
    typer.echo(
        f"wrote {out}: {schedule.cycles} cycles of {schedule.period_s:g} s, "
        f"springs at most {schedule.predicted.peak_c:.0f} C"
    )
