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

    The paper's figures of a run in the paper's scene; progress, kinds of bodies, gaits and walks of a run for
    building.

    Example: eldir analyse run --out figures
    """
    from eldir.core.files import require_new
    from eldir.evolution.designs import open_run
    from eldir.evolution.run_folder import RunFolder
    from eldir_app.terminal.progress import bar

    require_new(out)  # before the run is read, which takes seconds
    found = open_run(run)
    with bar() as progress:
        task = progress.add_task("", total=1.0)

        def step(what: str, part: float) -> None:
            progress.update(task, description=what, completed=part)

        if isinstance(found, RunFolder):
            from eldir.evolution.analysis import write_analysis

            write_analysis(found, out, step)
        else:
            from eldir.evolution.printed.analysis import write_printed_analysis

            write_printed_analysis(found, out, step)
    print(out / "index.html")
