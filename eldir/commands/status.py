"""The command `eldir status`: how a run stands."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer


def status(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")],
    as_json: Annotated[bool, typer.Option("--json", help="For another program.")] = False,
) -> None:
    """Tell how a run stands, also while it runs elsewhere.

    Example: eldir status run
    """
    from eldir.evolution.run_folder import Run
    from eldir.evolution.status import status_of

    found = status_of(Run.open(run))
    print(json.dumps(found.to_json(), indent=1) if as_json else f"{found.path}: {found.in_words()}")
