"""The commands that write heating schedules: `eldir gait` and `eldir rig hold`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer


def gait(
    design: Annotated[Path, typer.Argument(help="Design file.")],
    rig: Annotated[Path, typer.Option(help="Rig file: springs, supply, limits and channels.")],
    out: Annotated[Path, typer.Option(help="Schedule file to write, JSON.")],
    imitate: Annotated[
        bool,
        typer.Option(
            "--imitate", help="Use the phases of the controller, as in the paper. Default: search phases."
        ),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Also draw one predicted cycle into this file, PNG.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the samples.")] = 0,
    scene: Annotated[
        Path | None, typer.Option(help="Identified robot: a file of eldir calibrate dynamics.")
    ] = None,
) -> None:
    """Write a heating schedule for a design on a rig, and predict how far the robot walks.

    By default the command simulates the printed robot and searches phases, period and duty of its motors.
    With --imitate it copies the phases of the controller; with them, robots go forward only by chance. With
    --scene the search uses the identified robot. A filmed gait that walked is then kept, unless another gait
    is better by more than the uncertainty of its prediction.

    Example: eldir gait design.json --rig rig.yaml --out schedule.json
    """
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    from eldir.built.scene import BuiltScene
    from eldir.built.walking import describe_ties
    from eldir.core.files import require_ending, require_new, write_bytes
    from eldir.design import Design
    from eldir_app.terminal.progress import bar
    from eldir_hardware.planning.heat_preview import describe_walk
    from eldir_hardware.planning.heat_preview import heat_figure as draw
    from eldir_hardware.planning.plan import plan
    from eldir_hardware.planning.precision import remark
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.rig.packet_wiring import packet_of, wiring_note
    from eldir_hardware.rig.supply import implausible_springs
    from eldir_hardware.safety.margins import describe

    require_ending("--picture", picture, ".png")
    require_new(out, picture)
    robot, rig_file = Design.load(design), Rig.load(rig)
    known = None if scene is None else BuiltScene.load(scene)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with bar(*columns, note="planning: about a minute, or several where springs cool slowly") as progress:
        task = progress.add_task("reading", total=None)
        schedule = plan(
            robot,
            rig_file,
            imitate=imitate,
            seed=seed,
            design_file=os.path.relpath(design, out.parent),
            scene=known,
            stage=lambda what: progress.update(task, description=what),
        )
    schedule.save(out)
    if picture is not None:
        write_bytes(picture, draw(schedule))
    for method, walk in schedule.predicted.displacement.items():
        chosen = "*" if method == schedule.predicted.method else " "
        typer.echo(f"{chosen} {method}: {'; '.join(describe_walk(walk))}")
    own = schedule.predicted.walk
    if own is not None and own.tie_share is not None:
        typer.echo(describe_ties(own.tie_share))
    if schedule.predicted.choice is not None:
        typer.echo(schedule.predicted.choice)
    if known is not None and not known.model_fits:
        typer.echo(
            f"note: it is not certain that the model in {scene} fits the films, so its values are unreliable"
        )
    packet = packet_of(design, robot.morphology.motors)
    for note in implausible_springs(rig_file).values():
        typer.echo(f"warning: {note}", err=True)
    if note := wiring_note(rig_file, packet):
        typer.echo(f"note: not wired as {packet.source} says: {note}")
    if note := remark(schedule, rig_file):
        typer.echo(f"note: {note}")
    if schedule.predicted.margins is not None:
        typer.echo(describe(schedule.predicted.margins, rig_file))
    typer.echo(
        f"wrote {out}: {schedule.cycles} cycles of {schedule.period_s:g} s, "
        f"springs at most {schedule.predicted.peak_c:.0f} C"
    )
