"""The run folder of printed robots, from which a run can be read, resumed and repeated.

    run.json                  the configuration, "eldir-printed-run/1"
    generation-0003.parquet   every robot that was tried in a generation, with the result of its trials
    archive-0003.parquet      the elites after it, with the walks of all their samples; and the one before
    lock                      held by the process that evolves

The archive's file is written last: it makes a generation complete.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.core.records import record
from eldir.errors import InputError
from eldir.evolution import tables
from eldir.evolution.printed.archive import Archive, Walker, niche_of
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.genome import PrintedGenome
from eldir.evolution.printed.search import Generation, PrintedSearch, Refused
from eldir.evolution.run_folder import GenerationsFolder, StartedFile
from eldir.genotype import stack, unstack

if TYPE_CHECKING:
    import pyarrow as pa


@record
class PrintedRunFile(StartedFile):
    """The file run.json of an evolution of printed robots."""

    FORMAT = "eldir-printed-run/1"

    config: PrintedEvolutionConfig
    """The configuration: the same values give the same robots."""


@dataclass(frozen=True)
class PrintedRun(GenerationsFolder[PrintedEvolutionConfig]):
    """The folder of an evolution of printed robots."""

    FILE = PrintedRunFile
    COMPLETES = "archive"

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
        self._save(generation.number, tried, alive)

    def restore(self, refused: Refused = lambda body: "") -> PrintedSearch:
        """The search after the last complete generation, or a new one where there is none."""
        whole = self.whole_generations()
        if not whole:
            return PrintedSearch(self.config, refused)
        number, path = whole[-1]
        elites = {w.niche: w for w in self._walkers(path)}
        return PrintedSearch(self.config, refused, number + 1, Archive(elites))

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
