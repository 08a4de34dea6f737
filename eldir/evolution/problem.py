"""What evolves and how it is evaluated: the protocol of a problem, and the batches in which it is evaluated.

`eldir.evolution.search` asks a problem for solutions, and knows nothing else about them. The paper's robots
(`eldir.evolution.paper`), printed robots (`eldir.evolution.printed`) and a researcher's own problems
(`eldir.evolution.own`) are such problems.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir.evolution.archive import Archive, Solution

S = TypeVar("S", bound=Solution)
T = TypeVar("T")
BatchGenerator = Generator["Batch", Any, T]
"""Yields batches, is sent their outcomes, and returns what follows from them."""


class Part(Protocol):
    """Some tasks of a batch, which another process may evaluate."""

    @property
    def index(self) -> IntArray:
        """Indices of the tasks in the batch, shape (n,)."""

    def run(self) -> Any:
        """Evaluate the tasks in this process."""


class Batch(Protocol):
    """Tasks of one trial. The result of a task depends on nothing but the task."""

    @property
    def span(self) -> tuple[float, float]:
        """Fraction of the generation that is done before the batch and after it."""

    @property
    def has_long_tasks(self) -> bool:
        """Parts are worth a file of their own, and end where a run may be stopped. Otherwise tasks share
        vectors in the engine, and one machine evaluates them together."""

    def __len__(self) -> int:
        """Number of tasks."""

    def parts(self, index: IntArray, size: int) -> Iterator[Part]:
        """Tasks with these indices, in parts of at most `size`."""

    def join(self, found: Sequence[tuple[IntArray, Any]]) -> Any:
        """The outcome of the batch from all of its parts: their indices and results."""


class Problem(Protocol[S]):
    """What evolves: random solutions, their variation, and trials of rising cost that give their fitness."""

    seed: int
    """Seed of the run's random numbers."""
    generations: int
    """Generations after the random one."""
    capacity: int
    """Largest number of solutions in a niche of the archive."""

    def random(self, generation: int, rng: np.random.Generator) -> Sequence[Any]:
        """Random candidates, not evaluated."""

    def vary(self, archive: Archive[S], generation: int, rng: np.random.Generator) -> Sequence[Any]:
        """Offspring of the archive's elites, not evaluated."""

    def evaluate(
        self, candidates: Sequence[Any], archive: Archive[S]
    ) -> BatchGenerator[tuple[Sequence[Any], list[S]]]:
        """Run the trials, the cheap ones first. Returns all candidates with what the trials have shown, and
        as solutions with their fitness those that may enter the archive."""

    def sample(self, solutions: Sequence[S]) -> BatchGenerator[list[S]]:
        """Evaluate solutions again; returns them with further samples. Only where fitness has an error."""

    def choose_uncertain(self, archive: Archive[S]) -> list[S]:
        """Elites to evaluate again after each generation: the best of many estimates is too good."""


def evaluate_here(batch: Batch) -> Any:
    """The outcome of a batch, evaluated in this process."""
    parts = batch.parts(np.arange(len(batch)), len(batch))
    return batch.join([(part.index, part.run()) for part in parts])


@dataclass(frozen=True)
class TrialPart:
    """Some tasks of a trial."""

    index: IntArray
    trial: Callable[..., FloatArray]
    tasks: Sequence[Any]
    arguments: tuple[Any, ...]

    def run(self) -> FloatArray:
        return self.trial(self.tasks, *self.arguments)


@dataclass(frozen=True)
class TrialBatch:
    """Tasks for a function that gives each of them a row of numbers."""

    trial: Callable[..., FloatArray]
    """Called with tasks and `arguments`; returns an array with a row for each task."""
    tasks: Sequence[Any]
    span: tuple[float, float]
    arguments: tuple[Any, ...] = ()
    has_long_tasks = False

    def __len__(self) -> int:
        return len(self.tasks)

    def parts(self, index: IntArray, size: int) -> Iterator[TrialPart]:
        for k in range(0, len(index), size):
            own = index[k : k + size]
            yield TrialPart(own, self.trial, [self.tasks[i] for i in own], self.arguments)

    def join(self, found: Sequence[tuple[IntArray, FloatArray]]) -> FloatArray:
        rows = np.concatenate([result for _, result in found])
        return rows[np.argsort(np.concatenate([index for index, _ in found]))]
