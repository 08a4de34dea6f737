"""The run folder of printed robots, from which a run can be read, resumed and repeated.

    run.json                  the configuration, "eldir-printed-run/1"
    generation-0003.parquet   every robot that was tried in a generation, with the result of its trials
    archive-0003.parquet      the elites after it, with the walks of all their samples; and the one before
    lock                      held by the process that evolves

The archive's file is written last: it makes a generation complete.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.core import folder_lock
from eldir.core.files import new_folder, write_bytes
from eldir.core.provenance import source_digest
from eldir.core.records import FileRecord, SourceDigest, record
from eldir.core.version import __version__
from eldir.errors import InputError
from eldir.evolution import tables
from eldir.evolution.printed.archive import Archive, Walker, niche_of
from eldir.evolution.printed.configuration import PrintedEvolution
from eldir.evolution.printed.genome import PrintedGenome
from eldir.evolution.printed.search import Generation, PrintedSearch, Refused
from eldir.genotype import stack, unstack

if TYPE_CHECKING:
    import pyarrow as pa

_KEPT = 2  # archives: the one before stands in for a damaged one


@record
class PrintedRunFile(FileRecord):
    """The file run.json of an evolution of printed robots."""

    FORMAT = "eldir-printed-run/1"

    version: str
    """Version of eldir that wrote the file."""
    source: SourceDigest
    """Digest of the code that started the run."""
    config: PrintedEvolution
    """The configuration: the same values give the same robots."""


@dataclass(frozen=True)
class PrintedRun:
    """The folder of an evolution of printed robots."""

    path: Path
    config: PrintedEvolution
    source: str = field(default_factory=source_digest, compare=False)
    """Digest of the code that started the run."""

    @classmethod
    def create(cls, path: Path, config: PrintedEvolution) -> PrintedRun:
        """Make a new folder. Raises `EldirError` where the path exists already."""
        run = cls(path, config)
        with new_folder(path) as folder:
            PrintedRunFile(__version__, run.source, config).save(folder / "run.json")
        return run

    @classmethod
    def open(cls, path: Path) -> PrintedRun:
        """Open an existing folder. Raises `InputError` with the missing or damaged file."""
        file = PrintedRunFile.load(path / "run.json")
        return cls(path, file.config, file.source)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the run's lock: only one process evolves a run."""
        with folder_lock.locked(self.path):
            yield

    @property
    def evolving(self) -> bool:
        """Whether a process holds the lock."""
        return folder_lock.is_locked(self.path)

    def save(self, generation: Generation, archive: Archive) -> None:
        """Save a complete generation and the archive after it."""
        genomes = [t.genome for t in generation.tried]
        walks = {w.number: w.walks for w in generation.looked_at}
        tried = {
            "number": np.array([t.number for t in generation.tried], np.int64),
            "parent": np.array([t.parent for t in generation.tried], np.int64),
            **_genome_columns(genomes),
            "screened": generation.screened,
            "walks": tables.lists([walks.get(t.number, np.zeros(0)) for t in generation.tried], np.float64),
        }
        elites = archive.ranked()
        alive = {
            "number": np.array([w.number for w in elites], np.int64),
            "parent": np.array([w.parent for w in elites], np.int64),
            "generation": np.array([w.generation for w in elites], np.int64),
            **_genome_columns([w.genome for w in elites]),
            "walks": tables.lists([w.walks for w in elites], np.float64),
        }
        n = generation.number
        write_bytes(self.generation_file(n), tables.to_bytes(tried, "eldir-printed-generation/1"))
        write_bytes(self.path / f"archive-{n:04d}.parquet", tables.to_bytes(alive, "eldir-printed-archive/1"))
        for _, old in self.whole_generations()[:-_KEPT]:
            old.unlink()

    def restore(self, refused: Refused = lambda body: "") -> PrintedSearch:
        """The search after the last complete generation, or a new one where there is none."""
        whole = self.whole_generations()
        if not whole:
            return PrintedSearch(self.config, refused)
        number, path = whole[-1]
        elites = {w.niche: w for w in self._walkers(path)}
        return PrintedSearch(self.config, refused, number + 1, Archive(elites))

    def whole_generations(self) -> list[tuple[int, Path]]:
        """Numbers and archives of the complete generations on disk, ascending."""
        found = ((re.fullmatch(r"archive-(\d{4,})\.parquet", p.name), p) for p in self.path.iterdir())
        return sorted((int(match[1]), p) for match, p in found if match)

    def generation_file(self, generation: int) -> Path:
        """The file of all robots tried in a generation."""
        return self.path / f"generation-{generation:04d}.parquet"

    def _walkers(self, path: Path) -> list[Walker]:
        table, lattice = tables.read(path), self.config.lattice
        if not table.num_rows:
            return []
        try:
            return [
                Walker(int(number), int(parent), int(born), genome, niche_of(genome.body(lattice)), walks)
                for number, parent, born, genome, walks in zip(
                    table["number"].to_pylist(),
                    table["parent"].to_pylist(),
                    table["generation"].to_pylist(),
                    self._genomes(table),
                    tables.rows(table, "walks"),
                    strict=True,
                )
            ]
        except (KeyError, ValueError, TypeError, IndexError, InputError) as error:
            raise tables.damaged(path, "the elites of this run", error) from None

    def _genomes(self, table: pa.Table) -> list[PrintedGenome]:
        genotypes = unstack(*tables.genotype_columns(table, self.config.lattice))
        timings = table["timing"].to_pylist()
        if not all(0 <= t < len(self.config.timings) for t in timings):
            raise ValueError("a timing that the run does not have")
        of = zip(genotypes, tables.rows(table, "phases"), timings, strict=True)
        return [PrintedGenome(genotype, phases, int(timing)) for genotype, phases, timing in of]


def _genome_columns(genomes: Sequence[PrintedGenome]) -> dict[str, Any]:
    if not genomes:  # no robot of the generation walked
        return {"triangles": [], "springs": [], "phases": [], "timing": []}
    return {
        **tables.genotype_bits(*stack([g.genotype for g in genomes])),
        "phases": tables.lists([g.phases for g in genomes], np.float64),
        "timing": np.array([g.timing for g in genomes], np.int64),
    }
