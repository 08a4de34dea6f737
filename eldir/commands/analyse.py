"""The command `eldir analyse`: the paper's figures of a run."""

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
    """Draw the paper's figures of a run: index.html, SVG, PNG and CSV.

    Example: eldir analyse run --out figures
    """
    from eldir.commands.progress import bar
    from eldir.errors import InputError
    from eldir.evolution.analysis import write_analysis
    from eldir.evolution.designs import open_run
    from eldir.evolution.run_folder import RunFolder

    found = open_run(run)
    if not isinstance(found, RunFolder):
        raise InputError(
            f"{run} was evolved for building; there are no figures of such runs yet",
            expected="a run in the paper's scene",
            remedy=f"see eldir status {run}, or eldir shortlist",
        )
    with bar() as progress:
        task = progress.add_task("", total=1.0)
        write_analysis(found, out, lambda what, part: progress.update(task, description=what, completed=part))
    print(out / "index.html")
