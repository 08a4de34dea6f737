"""The command `eldir analyse`: figures of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def analyse(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder; the run may still be evolving.")],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="New folder for the page, the figures and the tables.")
    ],
) -> None:
    """Draw the figures of a run: index.html, SVG, PNG and CSV.

    For a run in the paper's scene: the paper's figures. For a run of printed robots: progress, kinds of
    bodies, gaits and walks.

    Example: eldir analyse run --out figures
    """
    from eldir.core.files import require_new
    from eldir.evolution.designs import open_run, require_robots
    from eldir.evolution.paper.run_folder import RunFolder
    from eldir_app.progress import progress_bar

    require_new(out)  # before the run is read, which takes seconds
    folder = require_robots(open_run(run))
    with progress_bar() as progress:
        task = progress.add_task("", total=1.0)

        def show(stage: str, fraction: float) -> None:
            progress.update(task, description=stage, completed=fraction)

        if isinstance(folder, RunFolder):
            from eldir.evolution.paper.analysis import write_analysis

            write_analysis(folder, out, show)
        else:
            from eldir.evolution.printed.analysis import write_printed_analysis

            write_printed_analysis(folder, out, show)
    print(out / "index.html")
