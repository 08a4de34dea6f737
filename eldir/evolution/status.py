"""The status of a run, read from its folder alone; another process may be evolving it."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Literal

from pydantic import NonNegativeInt, PositiveInt

from eldir.core.records import FileRecord, SourceDigest, record
from eldir.errors import InputError
from eldir.evolution.run_folder import GenerationsFolder


@record
class RunStatus(FileRecord):
    """What is known of every run."""

    path: str
    """Folder of the run."""
    state: Literal["evolving", "stopped", "finished"]
    """evolving: a program works on it; stopped: it can be resumed; finished: all generations are there."""
    whole: NonNegativeInt
    """Complete generations, the random one included."""
    wanted: PositiveInt
    """All generations of the configuration, the random one included."""
    source: SourceDigest
    """Digest of the code that started the run."""

    @abstractmethod
    def summary(self) -> str:
        """The status in one line."""


def read_status(run: GenerationsFolder[Any, Any]) -> RunStatus:
    """Read the status of a run of any kind."""
    for _ in range(3):  # while a process evolves, a file may go between being listed and being read
        try:
            return _status_of(run)
        except InputError:
            if not run.is_evolving:
                raise
    return _status_of(run)


def _status_of(run: GenerationsFolder[Any, Any]) -> RunStatus:
    complete = run.complete_generations()
    whole, wanted = (complete[-1][0] + 1 if complete else 0), run.config.generations + 1
    state = "finished" if whole == wanted else "evolving" if run.is_evolving else "stopped"
    return run.status(
        {"path": str(run.path), "state": state, "whole": whole, "wanted": wanted, "source": run.source}
    )
