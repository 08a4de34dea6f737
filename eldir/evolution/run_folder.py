"""Run folders: the files of an evolution, from which it can be read, resumed and repeated.

    run.json                  the configuration, "eldir-run/1"
    generation-0000.parquet   every robot evaluated in a generation, with all its losses
    survivors-0003.parquet    the last population, best first, with the learned weights; and the one before
    part-0004-000000.parquet  robots of the present generation that have learned
    lock                      held by the process that evolves

The survivors' file is written last: it makes a generation complete. Resuming starts after the last complete
generation, with the parts of the next one. Every file is written whole or not at all.
"""

from __future__ import annotations

import fcntl
import logging
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np

from eldir.core.files import new_folder, write_bytes
from eldir.core.kernels import Device
from eldir.core.records import FileRecord, IntArray, SourceDigest, record
from eldir.core.version import __version__, source_digest
from eldir.engine.device.process import chosen_device
from eldir.errors import EldirError, InputError, not_written
from eldir.evolution import tables
from eldir.evolution.population import LearnedRobots, LearningOutcome, is_valid
from eldir.evolution.search import EvolutionConfig, Search

_logger = logging.getLogger(__name__)
_KEPT = 2  # files that complete a generation: the one before stands in for a damaged one
_Config = TypeVar("_Config", bound="RunConfig")


class RunConfig(Protocol):
    """The configuration of a run of either kind."""

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


@record
class RunFile(RunFileHeader):
    """The file run.json of an evolution."""

    FORMAT = "eldir-run/1"
    OPTIONAL = frozenset({"device"})
    """What older runs lack."""

    config: EvolutionConfig
    """The configuration: the same values give the same robots."""
    device: Device = "cpu"
    """Where the robots of the first generation began to learn: cpu, cuda or vulkan. Devices and processors
    differ in the last digits."""


@dataclass(frozen=True)
class GenerationsFolder(Generic[_Config]):
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

    def _save(self, generation: int, evaluated: dict[str, Any], kept: dict[str, Any]) -> None:
        """Save the columns of a complete generation."""
        write_bytes(self.generation_file(generation), tables.to_bytes(evaluated, self._format("generation")))
        write_bytes(
            self.path / f"{self.COMPLETES}-{generation:04d}.parquet",
            tables.to_bytes(kept, self._format(self.COMPLETES)),
        )
        self._remove_outdated()

    def _format(self, what: str) -> str:
        """Name of the format of another file of this folder."""
        return str(self.FILE.FORMAT).replace("run", what)

    def _remove_outdated(self) -> None:
        """Remove the files that completed earlier generations, which are needed no longer."""
        for _, old in self.complete_generations()[:-_KEPT]:
            old.unlink()


@dataclass(frozen=True)
class RunFolder(GenerationsFolder[EvolutionConfig]):
    """The folder of an evolution in the paper's scene."""

    device: Device = field(default_factory=chosen_device, compare=False)
    """Where the robots learned when the run was started: cpu, cuda or vulkan."""

    FILE = RunFile
    COMPLETES = "survivors"

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open an existing folder. Raises `InputError` with the missing or damaged file."""
        file = cls.FILE.load(path / "run.json")
        return cls(path, file.config, file.source, file.device)

    def _file(self) -> FileRecord:
        return RunFile(__version__, self.source, self.config, self.device)

    def save_part(self, generation: int, ids: IntArray, outcome: LearningOutcome) -> None:
        """Save some robots of the present generation."""
        columns = {"id": ids, **tables.outcome_columns(outcome, self.config.scene.precision)}
        first = int(ids.min()) - generation * self.config.population
        write_bytes(
            self.path / f"part-{generation:04d}-{first:06d}.parquet",
            tables.to_bytes(columns, "eldir-part/1"),
        )

    def parts(self, generation: int) -> list[Path]:
        """Files of the robots of an incomplete generation that have learned."""
        return sorted(self.path.glob(f"part-{generation:04d}-*.parquet"))

    def save(self, search: Search, learned: LearnedRobots) -> None:
        """Save the last generation that `Search.tell` has selected."""
        generation = search.generation - 1
        if search.survivors is None:
            raise EldirError("nothing to save", expected="a search after a call of `tell`")
        sound = is_valid(learned.losses, self.config.training.jump_threshold)
        born = tables.robots_columns(learned.robots)
        born |= {"losses": tables.lists(list(learned.losses), np.float64), "valid": sound}
        born |= tables.flag_columns(learned)
        kept = search.survivors
        alive = tables.robots_columns(kept.robots)
        alive |= tables.outcome_columns(kept, self.config.scene.precision)
        if self.config.second_stage:
            born["walk"], alive["walk"] = learned.walks, kept.walks
        self._save(generation, born, alive)

    def _remove_outdated(self) -> None:
        """Also the parts of complete generations."""
        super()._remove_outdated()
        for generation, _ in self.complete_generations():
            for part in self.parts(generation):
                part.unlink()

    def restore(self) -> Search:
        """The search after the last complete generation, or a new one where there is none."""
        whole = self.complete_generations()
        if not whole:
            return Search(self.config)
        generation, path = whole[-1]
        _logger.info("%s: going on after generation %d", self.path, generation)
        survivors = tables.read_learned(path, self.config.lattice)
        return Search(self.config, generation=generation + 1, survivors=survivors)


def load_generation(path: Path | str, generation: int) -> dict[str, np.ndarray]:
    """Every robot evaluated in a generation: id, parents (N, 2), seed, triangles (N, B, A),
    springs (N, S), losses (N, iterations + 1), valid, and walk, chaotic_updates and rounded_updates
    (`LearnedRobots`), in order of id."""
    run = RunFolder.open(Path(path))
    file = run.generation_file(generation)
    table = tables.read(file)
    try:
        triangles, springs = tables.genotype_columns(table, run.config.lattice)
        return {
            "id": table["id"].to_numpy(),
            "parents": np.stack([table["parent_1"].to_numpy(), table["parent_2"].to_numpy()], axis=1),
            "seed": table["seed"].to_numpy(),
            "triangles": triangles,
            "springs": springs,
            "losses": np.stack(tables.rows(table, "losses")),
            "valid": np.array(table["valid"].to_pylist(), bool),
            "walk": np.array(table["walk"]) if "walk" in table.column_names else np.full(len(table), np.nan),
            **dict(zip(tables.FLAGS, tables.flags(table), strict=True)),
        }
    except (KeyError, ValueError, AttributeError) as error:
        raise tables.damaged(file, "the robots of this run", error) from None
