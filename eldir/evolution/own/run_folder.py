"""The run folder of a researcher's own problem, and the status that is read from it.

    generation-0003.parquet   every solution that was tried in a generation, with its last trial
    archive-0003.parquet      the elites after it, with all their samples; and the one before

Other files are as in `eldir.evolution.run_folder`. Only the search needs the problem's code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import NonNegativeInt

from eldir.core.records import record
from eldir.evolution import tables
from eldir.evolution.own.registration import load_problem
from eldir.evolution.own.vectors import OwnProblem, ProblemConfig, VectorSolution
from eldir.evolution.run_folder import GenerationsFolder, RunFileHeader
from eldir.evolution.search import Generation, Search
from eldir.evolution.status import RunStatus

_WHOLE, _RATED = ("number", "parent", "generation", "trials"), ("fitness", "error")


@record
class ProblemRunFile(RunFileHeader):
    """The file run.json of an evolution of a researcher's own problem."""

    FORMAT = "eldir-problem-run/1"

    config: ProblemConfig
    """The configuration."""


@record
class ProblemStatus(RunStatus):
    """The status of one run."""

    FORMAT = "eldir-problem-status/1"

    problem: str
    """Name of the problem."""
    tried: NonNegativeInt
    """Solutions tried so far."""
    elites: NonNegativeInt
    """Number of solutions in the archive."""
    best: float | None
    """Greatest fitness; null if there is none."""
    standard_error: float | None
    """Standard error of that fitness; null if there is none."""

    def summary(self) -> str:
        """The status in one line."""
        text = f"{self.state}, {self.whole} of {self.wanted} generations, {self.tried} solutions tried"
        if self.best is None:
            return text
        return (
            f"{text}; best {self.best:.4g} (standard error {self.standard_error:.2g}); {self.elites} elites"
        )


@dataclass(frozen=True)
class ProblemRun(GenerationsFolder[ProblemConfig, VectorSolution]):
    """The folder of an evolution of a researcher's own problem."""

    FILE = ProblemRunFile
    COMPLETES = "archive"

    def problem(self, *conditions: Any) -> OwnProblem:
        """`conditions`: the `VectorProblem`, where it is not installed."""
        (definition,) = conditions or (load_problem(self.config.problem),)
        return OwnProblem(definition, self.config)

    def columns(self, generation: Generation[VectorSolution]) -> tuple[dict[str, Any], dict[str, Any]]:
        return _columns(generation.tried), _columns(generation.elites)

    def read_elites(self, path: Path) -> list[VectorSolution]:
        table = tables.read(path)
        try:
            whole = [map(int, table[name].to_pylist()) for name in _WHOLE]
            rated = [map(float, table[name].to_pylist()) for name in _RATED]
            lists = [tables.rows(table, name) for name in ("solution", "measures", "objective")]
            return [
                VectorSolution(
                    number, parent, born, vector, tuple(niche.tolist()), samples, trials, fitness, error
                )
                for number, parent, born, trials, fitness, error, vector, niche, samples in zip(
                    *whole, *rated, *lists, strict=True
                )
            ]
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise tables.damaged(path, "the elites of this run", error) from None

    def status(self, common: dict[str, Any]) -> ProblemStatus:
        elites = self.read_last_elites()
        files = [self.generation_file(g) for g in range(common["whole"])]
        return ProblemStatus(
            **common,
            problem=self.config.problem,
            tried=sum(tables.read(file, ["number"]).num_rows for file in files),
            elites=len(elites),
            best=elites[0].fitness if elites else None,
            standard_error=elites[0].error if elites else None,
        )

    def progress_line(self, search: Search[VectorSolution]) -> str:
        ranked = search.archive.ranked()
        best = f", best {ranked[0].fitness:.4g}, {len(ranked)} elites" if ranked else ""
        return f"generation {max(0, search.generation - 1)}{best}"


def _columns(solutions: Sequence[VectorSolution]) -> dict[str, Any]:
    return {
        **{name: np.array([getattr(s, name) for s in solutions], np.int64) for name in _WHOLE},
        **{name: np.array([getattr(s, name) for s in solutions], np.float64) for name in _RATED},
        "solution": tables.lists([s.vector for s in solutions], np.float64),
        "measures": tables.lists([np.array(s.niche) for s in solutions], np.int64),
        "objective": tables.lists([s.objective for s in solutions], np.float64),
    }
