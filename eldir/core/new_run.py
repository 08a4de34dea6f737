"""The folder of a run that fails before anything is saved is removed: its name stays free."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def removed_if_nothing_is_saved(path: Path) -> Iterator[None]:
    """Remove the folder of a new run if it fails before a result is saved. Ctrl-C is no failure: the run can
    be resumed."""
    try:
        yield
    except Exception:
        if not has_results(path):
            shutil.rmtree(path, ignore_errors=True)
        raise


def has_results(path: Path) -> bool:
    """Whether a result is saved that resuming would start from."""
    return any(path.glob("*.parquet"))
