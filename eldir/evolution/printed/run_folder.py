"""The run folder of printed robots, from which a run can be read, resumed and repeated.

    run.json                  the configuration, "eldir-printed-run/1"
    generation-0003.parquet   every robot that was tried in a generation, with the result of its trials
    archive-0003.parquet      the elites after it, with the walks of all their samples; and the one before
    lock                      held by the process that evolves

The archive's file is written last: it makes a generation complete. `evolve_printed` continues a run, and
`read_status` reads its status from the folder alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeInt

from eldir.core.records import SourceDigest, record
from eldir.errors import InputError
from eldir.evolution import tables
from eldir.evolution.printed.archive import Archive, Walker, find_niche
from eldir.evolution.printed.configuration import PrintedEvolutionConfig, RejectionReason
from eldir.evolution.printed.genome import PrintedGenome
from eldir.evolution.printed.search import Evaluator, Generation, PrintedSearch, evaluate_here
from eldir.evolution.run_folder import GenerationsFolder, RunFileHeader
from eldir.evolution.status import RunStatus
from eldir.genotype import stack, unstack

if TYPE_CHECKING:
    import pyarrow as pa

WALKS = 1.0
"""An elite walks if its expected walk is above this [body lengths per five cycles]."""


@record
class PrintedRunFile(RunFileHeader):
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
        genomes = [t.genome for t in generation.candidates]
        walks = {w.number: w.walks for w in generation.evaluated}
        tried = {
            "number": np.array([t.number for t in generation.candidates], np.int64),
            "parent": np.array([t.parent for t in generation.candidates], np.int64),
            **_genome_columns(genomes),
            "screened": generation.screened_walks,
            "walks": tables.lists(
                [walks.get(t.number, np.zeros(0)) for t in generation.candidates], np.float64
            ),
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

    def restore(self, rejection_reason: RejectionReason = lambda body: "") -> PrintedSearch:
        """The search after the last complete generation, or a new one where there is none."""
        whole = self.complete_generations()
        if not whole:
            return PrintedSearch(self.config, rejection_reason)
        number, path = whole[-1]
        elites = {w.niche: w for w in self._walkers(path)}
        return PrintedSearch(self.config, rejection_reason, number + 1, Archive(elites))

    def _walkers(self, path: Path) -> list[Walker]:
        table, lattice = tables.read(path), self.config.lattice
        if not table.num_rows:
            return []
        try:
            return [
                Walker(int(number), int(parent), int(born), genome, find_niche(genome.body(lattice)), walks)
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

    def read_genome(self, generation: int, place: int) -> PrintedGenome:
        """The genome of a robot that was tried in a generation, by its place there. Raises `InputError` for a
        damaged file."""
        path = self.generation_file(generation)
        try:
            return self._genomes(tables.read(path).slice(place, 1))[0]
        except (KeyError, ValueError, TypeError, IndexError, InputError) as error:
            raise tables.damaged(path, "the robots of this run", error) from None

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


def evolve_printed(
    run: PrintedRun,
    rejection_reason: RejectionReason = lambda body: "",
    stopped: Callable[[PrintedSearch], bool] = lambda search: False,
    progress: Callable[[PrintedSearch, float], None] = lambda search, share: None,
    evaluate: Evaluator = evaluate_here,
) -> bool:
    """Continue a run to its end; returns whether it got there.

    `rejection_reason` says why a body cannot be built, and must be the same whenever a run is continued.
    `stopped` is asked before each generation; `progress` is called with the search and the present
    generation's share. `evaluate` runs the trials, such as `Cluster.evaluate`. The caller holds the run's
    lock if several processes may write.
    """
    search = run.restore(rejection_reason)
    search.evaluate = evaluate
    while not search.finished:
        if stopped(search):
            return False
        generation = search.step(lambda share: progress(search, min(share, 0.99)))
        run.save(generation, search.archive)
        progress(search, 0.0)
    return True


@record
class PrintedStatus(RunStatus):
    """The status of one run."""

    FORMAT = "eldir-printed-status/1"

    tried: NonNegativeInt
    """Robots tried so far."""
    niches: Annotated[NonNegativeInt, Field(alias="kinds")]
    """Number of occupied niches in the archive."""
    walking: NonNegativeInt
    """Elites whose expected walk is above 1 body length in five cycles."""
    best: float | None
    """Expected walk of the best elite [body lengths per five cycles]; null if there is none."""
    standard_error: float | None
    """Standard error of that expected walk [body lengths per five cycles]; null where one sample is known."""
    samples: NonNegativeInt
    """Number of samples of the best elite."""
    source: SourceDigest
    """Digest of the code that started the run."""

    def summary(self) -> str:
        """The status in one line."""
        text = f"{self.state}, {self.whole} of {self.wanted} generations, {self.tried} robots tried"
        if self.best is not None:
            error = math.inf if self.standard_error is None else self.standard_error
            text += (
                f"; best {self.best:+.2f} +- {error:.2f} body lengths in 5 cycles "
                f"({self.samples} samples); {self.niches} niches, {self.walking} above {WALKS:g}"
            )
        return text


def progress_line(generation: int, archive: Archive) -> str:
    """A short line for the progress bar: the last complete generation, in the first one that one itself."""
    best = _best(archive)
    if best is None:
        return "no walker yet"
    walking = sum(w.expected > WALKS for w in archive.elites.values())
    return (
        f"generation {max(0, generation - 1)}, best {best.expected:+.2f} +- {best.error:.2f}, "
        f"{walking} above {WALKS:g}"
    )


def read_status(run: PrintedRun) -> PrintedStatus:
    """Read the status of a run."""
    search = run.restore()
    archive, whole = search.archive, search.generation
    best = _best(archive)
    tried = sum(tables.read(run.generation_file(g), ["number"]).num_rows for g in range(whole))
    return PrintedStatus(
        path=str(run.path),
        state="finished" if search.finished else "evolving" if run.is_evolving else "stopped",
        whole=whole,
        wanted=run.config.generations + 1,
        tried=tried,
        niches=len(archive.elites),
        walking=sum(w.expected > WALKS for w in archive.elites.values()),
        best=None if best is None else best.expected,
        standard_error=best.error if best is not None and math.isfinite(best.error) else None,
        samples=0 if best is None else len(best.walks),
        source=run.source,
    )


def _best(archive: Archive) -> Walker | None:
    return next(iter(archive.ranked()), None)
