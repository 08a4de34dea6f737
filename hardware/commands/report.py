"""The command `eldir report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Logs of runs (MCAP): of the robot, and of it without a motor or with ballast.",
        ),
    ],
    design: Annotated[
        Path, typer.Option(help="The design that was driven, or of which control robots were built.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to make.")],
    scene: Annotated[
        Path | None,
        typer.Option(help="The robot as films showed it, from `eldir calibrate dynamics`: predict that one."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON.")] = False,
) -> None:
    """Compare the evolved, the predicted and the filmed motion; everything is computed from the logs alone.

    Example: eldir report log.mcap control.mcap --design design.json --out report
    """
    from eldir.core.files import require_new
    from eldir.core.worker_process import WorkerProcess

    require_new(out)
    # The worker imports while this process does.
    with WorkerProcess("hardware.analysis.predictions") as worker:
        from rich.progress import SpinnerColumn, TextColumn

        from calibration.report.page import write_report
        from eldir.built.scene import BuiltScene
        from eldir.commands.progress import bar
        from eldir.design import Design
        from hardware.analysis.motions import analyse

        robot = Design.load(design)
        known = None if scene is None else BuiltScene.load(scene)
        columns = (SpinnerColumn(), TextColumn("tracking: {task.completed} frames"))
        with bar(*columns) as progress:
            task = progress.add_task("", total=None)
            content = analyse(logs, robot, worker, lambda n: progress.update(task, completed=n), known)
    found = write_report(content, out)
    if as_json:
        typer.echo((out / "report.json").read_text(), nl=False)
        return
    for warning in (*found.warnings, *content.remarks):
        typer.echo(f"note: {warning}")
    walks = ", ".join(f"{kind} {value:+.2f}" for kind, value in found.displacement.items())
    typer.echo(f"wrote {out}/index.html; body lengths per five cycles: {walks}")
