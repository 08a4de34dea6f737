"""The command `eldir status`: the status of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def status(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the status as JSON.")] = False,
) -> None:
    """Print the status of a run. The run may still be evolving in another process.

    Example: eldir status run
    """
    from eldir.evolution.designs import open_run
    from eldir_app.evolution_run import print_status

    print_status(open_run(run), as_json)
