"""Problems whose solutions are vectors of numbers: the class that a researcher writes, and its run.

The words are those of pyribs: objective, which is maximised, and measures. Its archives and emitters take the
same methods (`examples/gait_by_ribs.py`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir import defaults
from eldir.core.records import FloatArray, IntArray, Record, record
from eldir.errors import InputError
from eldir.evolution.archive import Archive
from eldir.evolution.problem import BatchGenerator, TrialBatch

_REEVALUATED = 3  # elites that are evaluated again in a generation


class VectorProblem(ABC):
    """A problem whose solutions are vectors of `d` numbers. All methods must give the same for the same
    arguments; a row depends on no other row."""

    capacity: int = 1
    """Largest number of solutions in a niche of the archive."""
    shares: tuple[float, ...] = (1.0,)
    """Shares of a generation that reach each trial, the cheapest trial first. The last one gives the
    fitness."""
    max_samples: int = 0
    """Samples up to which elites are evaluated again; 0: the objective has no error."""

    @abstractmethod
    def random(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Random solutions, shape (n, d)."""

    @abstractmethod
    def vary(self, parents: FloatArray, rng: np.random.Generator) -> FloatArray:
        """One offspring of each parent, shapes (n, d)."""

    @abstractmethod
    def evaluate(self, solutions: FloatArray, trial: int, seeds: Sequence[int]) -> FloatArray:
        """Samples of the objective of solutions (n, d) in a trial, shape (n, samples). Samples that are drawn
        come from the solution's seed, which differs each time that it is evaluated. NaN: not a solution."""

    def fitness(self, samples: FloatArray) -> tuple[float, float]:
        """Fitness and its standard error from all samples of the last trial, shape (samples,)."""
        error = samples.std(ddof=1) / np.sqrt(len(samples)) if len(samples) > 1 else 0.0
        return float(samples.mean()), float(error)

    def measures(self, solutions: FloatArray) -> IntArray:
        """The niche of each solution (n, d): whole numbers, shape (n, measures). By default all share one."""
        return np.zeros((len(solutions), 0), np.int64)


@record
class ProblemConfig(Record):
    """The configuration of a run: the same values and code of the problem give the same solutions."""

    problem: str
    """Name of the problem: its entry point in the group eldir.problems."""
    offspring: Annotated[int, Field(ge=1, le=defaults.MAX_POPULATION)] = 32
    """Number of solutions of a generation."""
    generations: Annotated[int, Field(ge=0, le=defaults.MAX_GENERATIONS)] = 20
    """Generations of offspring after the random one."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the run's random numbers."""


@dataclass(frozen=True, eq=False)
class VectorSolution(Record):
    """A solution and what its trials have shown."""

    number: int
    """Unique in a run."""
    parent: int
    """Number of its parent; -1 for a random one."""
    generation: int
    vector: FloatArray
    """Shape (d,)."""
    niche: tuple[int, ...] = ()
    objective: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Samples of the last trial that it reached, shape (samples,)."""
    trials: int = 0
    """Number of trials that it reached."""
    fitness: float = -np.inf
    error: float = np.inf
    """Standard error of the fitness."""

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.objective)


class OwnProblem:
    """A vector problem as the search asks for it (`eldir.evolution.problem.Problem`)."""

    def __init__(self, definition: VectorProblem, config: ProblemConfig) -> None:
        self.definition, self.config = definition, config
        self.seed, self.generations, self.capacity = config.seed, config.generations, definition.capacity

    def random(self, generation: int, rng: np.random.Generator) -> list[VectorSolution]:
        n = self.config.offspring
        return self._number("random", self.definition.random(n, rng), [-1] * n, generation)

    def vary(
        self, archive: Archive[VectorSolution], generation: int, rng: np.random.Generator
    ) -> list[VectorSolution]:
        elites = archive.ranked()
        parents = [elites[i] for i in rng.integers(len(elites), size=self.config.offspring)]
        vectors = self.definition.vary(np.stack([s.vector for s in parents]), rng)
        return self._number("vary", vectors, [s.number for s in parents], generation)

    def _number(
        self, method: str, vectors: FloatArray, parents: Sequence[int], generation: int
    ) -> list[VectorSolution]:
        vectors = self._require_rows(method, vectors, len(parents))
        if not np.isfinite(vectors).all():
            raise self._error(method, "finite numbers", "NaN or infinity")
        first = generation * self.config.offspring
        return [
            VectorSolution(first + i, parent, generation, vector)
            for i, (vector, parent) in enumerate(zip(vectors, parents, strict=True))
        ]

    def evaluate(
        self, candidates: Sequence[VectorSolution], archive: Archive[VectorSolution]
    ) -> BatchGenerator[tuple[list[VectorSolution], list[VectorSolution]]]:
        tried = {s.number: s for s in candidates}
        going_on = list(candidates)
        shares = self.definition.shares
        for trial, share in enumerate(shares):
            going_on = going_on[: max(1, round(share * len(candidates)))]
            span = (0.9 * trial / len(shares), 0.9 * (trial + 1) / len(shares))
            rows = yield self._batch(going_on, trial, span)
            rows = self._require_rows("evaluate", rows, len(going_on))
            going_on = [
                replace(s, objective=own, trials=trial + 1) for s, own in zip(going_on, rows, strict=True)
            ]
            tried |= {s.number: s for s in going_on}
            going_on.sort(key=lambda s: -np.nan_to_num(s.objective.mean(), nan=-np.inf))
        niches = self.definition.measures(np.stack([s.vector for s in going_on]))
        niches = self._require_rows("measures", niches, len(going_on))
        evaluated = [
            self._rate(replace(s, niche=tuple(int(m) for m in niche)))
            for s, niche in zip(going_on, niches, strict=True)
        ]
        tried |= {s.number: s for s in evaluated}
        return list(tried.values()), evaluated

    def sample(self, solutions: Sequence[VectorSolution]) -> BatchGenerator[list[VectorSolution]]:
        if not solutions:
            return []
        rows = yield self._batch(solutions, len(self.definition.shares) - 1, (0.9, 0.99))
        rows = self._require_rows("evaluate", rows, len(solutions))
        return [
            self._rate(replace(s, objective=np.concatenate([s.objective, own])))
            for s, own in zip(solutions, rows, strict=True)
        ]

    def choose_uncertain(self, archive: Archive[VectorSolution]) -> list[VectorSolution]:
        ranked = archive.ranked()
        return [s for s in ranked if s.samples < self.definition.max_samples][:_REEVALUATED]

    def _rate(self, solution: VectorSolution) -> VectorSolution:
        """The solution with its fitness; one with a sample that is not finite does not enter the archive."""
        if not np.isfinite(solution.objective).all():
            return solution
        fitness, error = self.definition.fitness(solution.objective)
        return replace(solution, fitness=float(fitness), error=float(error))

    def _batch(self, some: Sequence[VectorSolution], trial: int, span: tuple[float, float]) -> TrialBatch:
        seeds = [np.random.SeedSequence(self.seed, spawn_key=(s.number, trial, s.samples)) for s in some]
        tasks = [
            (s.vector, int(seed.generate_state(1, np.uint64)[0] >> 1))
            for s, seed in zip(some, seeds, strict=True)
        ]
        return TrialBatch(evaluate_vectors, tasks, span, (self.definition, trial))

    def _require_rows(self, method: str, rows: object, n: int) -> np.ndarray:
        found = np.asarray(rows)
        if found.ndim != 2 or len(found) != n or found.dtype.kind not in "biuf":
            raise self._error(method, f"an array of numbers with {n} rows", f"shape {found.shape}")
        return found

    def _error(self, method: str, expected: str, found: str) -> InputError:
        return InputError(
            f"the problem {self.config.problem} returned a wrong array from its method {method}",
            code="problem.wrong-array", key=method, expected=expected, found=found,
            remedy="correct the method",
        )  # fmt: skip


def evaluate_vectors(
    tasks: Sequence[tuple[FloatArray, int]], definition: VectorProblem, trial: int
) -> FloatArray:
    """Samples of vectors with their seeds, shape (tasks, samples)."""
    vectors, seeds = zip(*tasks, strict=True)
    return definition.evaluate(np.stack(vectors), trial, list(seeds))
