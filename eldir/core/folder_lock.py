"""The lock of a run folder: only one process evolves a run at a time. It is free when that process ends."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from eldir.errors import EldirError, not_written


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the run's lock, and remove drafts of files that a killed process left behind."""
    try:
        lock = (path / "lock").open("w")
    except OSError as error:
        raise not_written(path, error, "make it writable") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            problem = f"another process is evolving {path}"
            raise EldirError(problem, code="run.locked", remedy=f"see eldir status {path}") from None
        for draft in path.glob(".*.parquet.*"):
            draft.unlink()
        yield


def is_locked(path: Path) -> bool:
    """Whether a process holds the lock."""
    with suppress(FileNotFoundError), (path / "lock").open() as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
