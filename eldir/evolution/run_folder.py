"""Run folders: the files of an evolution, from which it can be read, resumed and repeated.

    run.json                  the configuration
    generation-0000.parquet   every solution that was tried in a generation
    survivors-0003.parquet    the elites after it, from which the search goes on; and those of the one before
    lock                      held by the process that evolves

The elites' file, whose name depends on the kind of run, is written last: it makes a generation complete.
Every file is written whole or not at all.
"""

from __future__ import annotations

import fcntl
import logging
import re
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, Self, TypeVar

from eldir.core.files import new_folder, write_bytes
from eldir.core.records import FileRecord, IntArray, SourceDigest, record
from eldir.core.version import __version__, source_digest
from eldir.errors import EldirError, InputError, not_written
from eldir.evolution import tables
from eldir.evolution.archive import Solution
from eldir.evolution.problem import Batch, Problem
from eldir.evolution.search import Generation, Search
from eldir.evolution.workers import LocalWorkers, Workers

if TYPE_CHECKING:
    from eldir.evolution.status import RunStatus

_logger = logging.getLogger(__name__)
_KEPT = 2  # files that complete a generation: the one before stands in for a damaged one
_Config = TypeVar("_Config", bound="RunConfig")
_Solution = TypeVar("_Solution", bound=Solution)


class RunConfig(Protocol):
    """The configuration of a run of any kind."""

    @property
    def generations(self) -> int:
        """Generations after the random one."""


@record
class RunFileHeader(FileRecord):
    """What the file run.json of an evolution of any kind begins with."""

    version: str
    """Version of eldir that wrote the file."""
    source: SourceDigest
    """Digest of the code that started the run."""


@dataclass(frozen=True)
class GenerationsFolder(ABC, Generic[_Config, _Solution]):
    """The folder of an evolution of any kind, which saves one generation after the other: every robot of a
    generation in one file, and then what the search continues from in another, which makes it complete."""

    path: Path
    config: _Config
    source: str = field(default_factory=source_digest, compare=False)
    """Digest of the code that started the run."""

    FILE: ClassVar[Any]
    """The record in run.json: version, source, configuration."""
    COMPLETES: ClassVar[str]
    """Name of the files that complete a generation."""

    @abstractmethod
    def problem(self, *conditions: Any) -> Problem[_Solution]:
        """The problem of the run. `conditions` are further conditions on solutions, which a run folder does
        not contain; they must be the same whenever a run is continued."""

    @abstractmethod
    def columns(self, generation: Generation[_Solution]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Columns of all solutions that were tried in a generation, and of the elites after it."""

    @abstractmethod
    def read_elites(self, path: Path) -> list[_Solution]:
        """The elites in a file that completes a generation. Raises `InputError` for a damaged one."""

    @abstractmethod
    def status(self, common: dict[str, Any]) -> RunStatus:
        """The status of the run; `common` has the fields of every status."""

    @abstractmethod
    def progress_line(self, search: Search[_Solution]) -> str:
        """A short line for the progress bar: the last complete generation and its best solutions."""

    def workers(self) -> Workers:
        """What evaluates batches on this machine."""
        return LocalWorkers()

    def read_parts(self, batch: Batch) -> list[tuple[IntArray, Any]]:
        """Indices and results of the tasks of a batch that an interrupted run has saved."""
        return []

    def save_part(self, result: Any) -> None:
        """Save the result of a part of a batch that has long tasks."""

    @classmethod
    def create(cls, path: Path, config: _Config) -> Self:
        """Make a new folder. Raises `EldirError` where the path exists already."""
        run = cls(path, config)
        with new_folder(path) as folder:
            run._file().save(folder / "run.json")
        return run

    def _file(self) -> FileRecord:
        """The file run.json."""
        file: FileRecord = self.FILE(__version__, self.source, self.config)
        return file

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open an existing folder. Raises `InputError` with the missing or damaged file."""
        file = cls.FILE.load(path / "run.json")
        return cls(path, file.config, file.source)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the run's lock: only one process evolves a run. Remove what a killed one left behind."""
        try:
            lock = (self.path / "lock").open("w")
        except OSError as error:
            raise not_written(self.path, error, "make it writable") from None
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                problem = f"another process is evolving {self.path}"
                raise EldirError(problem, code="run.locked", remedy=f"see eldir status {self.path}") from None
            for draft in self.path.glob(".*.parquet.*"):
                draft.unlink()
            self._remove_outdated()
            yield

    @contextmanager
    def remove_if_empty(self) -> Iterator[None]:
        """Remove the folder of a new run if it fails before a result is saved: its name stays free. Ctrl-C is
        no failure: the run can be resumed."""
        try:
            yield
        except Exception:
            if not self.has_results:
                shutil.rmtree(self.path, ignore_errors=True)
            raise

    @property
    def has_results(self) -> bool:
        """Whether a result is saved that resuming would start from."""
        return any(self.path.glob("*.parquet"))

    @property
    def is_evolving(self) -> bool:
        """Whether a process holds the lock."""
        with suppress(FileNotFoundError), (self.path / "lock").open() as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
        return False

    def complete_generations(self) -> list[tuple[int, Path]]:
        """Numbers of the complete generations on disk, and the files that complete them, ascending."""
        name = re.compile(rf"{self.COMPLETES}-(\d{{4,}})\.parquet")
        found = ((name.fullmatch(p.name), p) for p in self.path.iterdir())
        return sorted((int(match[1]), p) for match, p in found if match)

    def require_generations(self) -> list[tuple[int, Path]]:
        """`complete_generations`. Raises `InputError` where there is none."""
        if whole := self.complete_generations():
            return whole
        problem = f"{self.path} has no complete generation yet"
        remedy = f"continue with eldir evolve --resume {self.path}"
        raise InputError(problem, code="run.no-generation", remedy=remedy)

    def generation_file(self, generation: int) -> Path:
        """The file of all robots evaluated in a generation."""
        return self.path / f"generation-{generation:04d}.parquet"

    def restore(self, *conditions: Any) -> Search[_Solution]:
        """The search after the last complete generation, or a new one where there is none; `conditions` as in
        `problem`."""
        problem, whole = self.problem(*conditions), self.complete_generations()
        if not whole:
            return Search(problem)
        number, path = whole[-1]
        _logger.info("%s: going on after generation %d", self.path, number)
        return Search(problem, number + 1, self.read_elites(path))

    def read_last_elites(self) -> list[_Solution]:
        """The elites after the last complete generation, the best first; none before the first one."""
        whole = self.complete_generations()
        return self.read_elites(whole[-1][1]) if whole else []

    def save(self, generation: Generation[_Solution]) -> None:
        """Save a complete generation."""
        tried, elites = self.columns(generation)
        last = self.path / f"{self.COMPLETES}-{generation.number:04d}.parquet"
        write_bytes(
            self.generation_file(generation.number), tables.to_bytes(tried, self._format("generation"))
        )
        write_bytes(last, tables.to_bytes(elites, self._format(self.COMPLETES)))
        self._remove_outdated()

    def _format(self, what: str) -> str:
        """Name of the format of another file of this folder."""
        return str(self.FILE.FORMAT).replace("run", what)

    def _remove_outdated(self) -> None:
        """Remove the files that completed earlier generations, which are needed no longer."""
        for _, old in self.complete_generations()[:-_KEPT]:
            old.unlink()
