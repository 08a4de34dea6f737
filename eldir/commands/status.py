"""The command `eldir status`: the status of a run."""

from __future__ import annotations

import json
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
    from eldir.evolution.printed import status as printed
    from eldir.evolution.printed.run_folder import PrintedRun
    from eldir.evolution.status import status_of

    opened = open_run(run)
    found = printed.status_of(opened) if isinstance(opened, PrintedRun) else status_of(opened)
    print(json.dumps(found.to_json(), indent=1) if as_json else f"{found.path}: {found.summary()}")
