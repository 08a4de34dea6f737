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
            help="Logs (MCAP) of runs of the robot, and of the same robot without a motor or with ballast.",
        ),
    ],
    design: Annotated[
        Path, typer.Option(help="Design file of the intact robot, even if a log shows a control robot.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to create.")],
    scene: Annotated[
        Path | None,
        typer.Option(help="Scene file from `eldir calibrate dynamics`: predict with the identified robot."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON.")] = False,
) -> None:
    """Compare the learned, the predicted and the filmed motion of a robot, computed from its logs alone.

    Example: eldir report log.mcap control.mcap --design design.json --out report
    """
    from eldir.core.files import require_new
    from eldir.core.worker_process import WorkerProcess

    require_new(out)
    # The worker process imports at the same time as this one.
    with WorkerProcess("eldir_calibration.comparison.predictions") as worker:
        from eldir.built.scene import PrintedScene
        from eldir.design import Design
        from eldir_app.progress import progress_bar
        from eldir_calibration.comparison.motions import prepare_report
        from eldir_calibration.report.comparison import MOTION_NAMES, NOT_COMPARABLE
        from eldir_calibration.report.page import write_report

        robot = Design.load(design)
        identified = None if scene is None else PrintedScene.load(scene)
        with progress_bar() as progress:
            task = progress.add_task("tracking the film", total=None)

            def show(frames: int, total: int) -> None:
                last = "; predicting robots like this one" * (frames == total)
                progress.update(task, completed=frames, total=total, description=f"tracking the film{last}")

            content = prepare_report(logs, robot, worker, show, identified)
    motion = write_report(content, out)
    if as_json:
        typer.echo((out / "report.json").read_text(), nl=False)
        return
    for warning in (*motion.warnings, *content.remarks):
        typer.echo(f"note: {warning}")
    typer.echo(content.verdict.text)
    comment = {"predicted": " (most probable robot)"}
    walks = ", ".join(
        f"{MOTION_NAMES[kind]} {value:+.2f}{comment.get(kind, '')}"
        for kind, value in motion.displacement.items()
    )
    typer.echo(f"wrote {out}/index.html; body lengths per five cycles: {walks}")
    typer.echo(NOT_COMPARABLE)
