"""The run folder of printed robots, and the status that is read from it.

    generation-0003.parquet   every robot that was tried in a generation, with the result of its trials
    archive-0003.parquet      the elites after it, with the walks of all their samples; and the one before

Other files are as in `eldir.evolution.run_folder`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeInt

from eldir.core.records import IntArray, record
from eldir.errors import InputError
from eldir.evolution import tables
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.genome import PrintedGenome
from eldir.evolution.printed.problem import Candidate, PrintedProblem
from eldir.evolution.printed.walker import Walker, find_niche
from eldir.evolution.run_folder import GenerationsFolder, RunFileHeader
from eldir.evolution.search import Generation, Search
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

    def summary(self) -> str:
        """The status in one line."""
        text = f"{self.state}, {self.whole} of {self.wanted} generations, {self.tried} robots tried"
        if self.best is not None:
            error = math.inf if self.standard_error is None else self.standard_error
            text += (
                f"; best {self.best:+.2f} body lengths in 5 cycles "
                f"(standard error {error:.2f} of {self.samples} samples); {self.niches} niches, "
                f"{self.walking} above {WALKS:g}"
            )
        return text


@dataclass(frozen=True)
class PrintedRun(GenerationsFolder[PrintedEvolutionConfig, Walker]):
    """The folder of an evolution of printed robots."""

    FILE = PrintedRunFile
    COMPLETES = "archive"

    def problem(self, *conditions: Any) -> PrintedProblem:
        """`conditions`: the `RejectionReason` of a workshop, which says why a body cannot be built."""
        return PrintedProblem(self.config, *conditions)

    def columns(self, generation: Generation[Walker]) -> tuple[dict[str, Any], dict[str, Any]]:
        walks = {w.number: w.walks for w in generation.evaluated}
        candidates: Sequence[Candidate] = generation.tried
        tried = {
            **_columns(candidates),
            "screened": np.array([c.screened for c in candidates]),
            "walks": tables.lists([walks.get(c.number, np.zeros(0)) for c in candidates], np.float64),
        }
        elites = generation.elites
        born = np.array([w.generation for w in elites], np.int64)
        walks_of_elites = tables.lists([w.walks for w in elites], np.float64)
        return tried, {**_columns(elites, generation=born), "walks": walks_of_elites}

    def read_elites(self, path: Path) -> list[Walker]:
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

    def status(self, common: dict[str, Any]) -> PrintedStatus:
        elites = self.read_last_elites()
        best = elites[0] if elites else None
        files = [self.generation_file(g) for g in range(common["whole"])]
        return PrintedStatus(
            **common,
            tried=sum(tables.read(file, ["number"]).num_rows for file in files),
            niches=len(elites),
            walking=sum(w.expected > WALKS for w in elites),
            best=None if best is None else best.expected,
            standard_error=best.error if best is not None and math.isfinite(best.error) else None,
            samples=0 if best is None else best.samples,
        )

    def progress_line(self, search: Search[Walker]) -> str:
        """In the first generation, that one itself."""
        elites = search.archive.ranked()
        if not elites:
            return "no walker yet"
        walking, best = sum(w.expected > WALKS for w in elites), elites[0]
        return (
            f"generation {max(0, search.generation - 1)}, best {best.expected:+.2f} (standard error "
            f"{best.error:.2f}), {walking} above {WALKS:g}"
        )

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


def _columns(robots: Sequence[Candidate] | Sequence[Walker], **further: IntArray) -> dict[str, Any]:
    """Columns with identity, further ones, and genome."""
    genomes = [r.genome for r in robots]
    number, parent = (np.array([getattr(r, k) for r in robots], np.int64) for k in ("number", "parent"))
    columns: dict[str, Any] = {"number": number, "parent": parent, **further}
    if not genomes:  # no robot of the generation walked
        return columns | {"triangles": [], "springs": [], "phases": [], "timing": []}
    return {
        **columns,
        **tables.genotype_bits(*stack([g.genotype for g in genomes])),
        "phases": tables.lists([g.phases for g in genomes], np.float64),
        "timing": np.array([g.timing for g in genomes], np.int64),
    }
