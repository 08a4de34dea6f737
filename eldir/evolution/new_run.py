"""The folder of a run that fails before anything is saved is removed: its name stays free."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eldir.evolution.printed.run_folder import PrintedRun
    from eldir.evolution.run_folder import RunFolder


@contextmanager
def removed_if_nothing_is_saved(run: RunFolder | PrintedRun) -> Iterator[None]:
    """Remove the folder of a new run if it fails before a result is saved. Ctrl-C is no failure: the run can
    be resumed."""
    try:
        yield
    except Exception:
        if not has_results(run):
            shutil.rmtree(run.path, ignore_errors=True)
        raise


def has_results(run: RunFolder | PrintedRun) -> bool:
    """Whether a result is saved that resuming would start from."""
    return any(run.path.glob("*.parquet"))
