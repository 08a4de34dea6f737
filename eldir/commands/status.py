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
    from eldir.evolution.run_folder import RunFolder
    from eldir.evolution.status import status_of

    found = status_of(RunFolder.open(run))
    print(json.dumps(found.to_json(), indent=1) if as_json else f"{found.path}: {found.summary()}")
