"""The search: ask for a batch, evaluate it, tell its outcome, until the search is finished.

    batch = search.ask()
    search.tell(batch, evaluate(batch))

A generation begins with random solutions or with offspring of the archive. Trials of rising cost
(`Problem.evaluate`) leave those that may enter the archive. One that would displace an elite that is better
known is evaluated again first, and some elites are evaluated again at the end, because the best of many
estimates is too good (winner's curse). What is random depends on the run's seed and the generation alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from eldir.errors import EldirError
from eldir.evolution.archive import Archive, Solution
from eldir.evolution.problem import Batch, BatchGenerator, Problem

S = TypeVar("S", bound=Solution)


@dataclass(frozen=True)
class Generation(Generic[S]):
    """A complete generation."""

    number: int
    tried: Sequence[Any]
    """All candidates, with what their trials have shown."""
    evaluated: Sequence[S]
    """Solutions that reached the last trial."""
    elites: Sequence[S]
    """All elites after it, the best first."""


class Search(Generic[S]):
    """The state of a search after its last complete generation."""

    def __init__(self, problem: Problem[S], generation: int = 0, elites: Iterable[S] = ()) -> None:
        self.problem = problem
        self.generation = generation
        """Number of the generation that comes next."""
        self.archive = Archive(elites, problem.capacity)
        self._generator: BatchGenerator[Generation[S]] | None = None
        self._batch: Batch | None = None

    @property
    def finished(self) -> bool:
        """Whether the last generation is complete."""
        return self.generation > self.problem.generations

    def ask(self) -> Batch:
        """The batch to evaluate next; the same one until its outcome is told."""
        if self._batch is None:
            self._generator = self._run_generation()
            self._batch = next(self._generator)
        return self._batch

    def tell(self, batch: Batch, outcome: Any) -> Generation[S] | None:
        """Go on with the outcome of the batch that was asked for. Returns the generation once it is complete.
        Raises `EldirError` where the problem cannot go on."""
        if self._generator is None or batch is not self._batch:
            raise EldirError(
                "a search was told the outcome of another batch",
                code="evolution.other-batch",
                expected="the batch that `ask` gave last",
            )
        self._batch = None
        try:
            self._batch = self._generator.send(outcome)
        except StopIteration as end:
            self.generation += 1
            complete: Generation[S] = end.value
            return complete
        return None

    def _run_generation(self) -> BatchGenerator[Generation[S]]:
        problem, number = self.problem, self.generation
        rng = np.random.default_rng(np.random.SeedSequence(problem.seed, spawn_key=(number,)))
        if len(self.archive):
            candidates = problem.vary(self.archive, number, rng)
        else:
            candidates = problem.random(number, rng)
        tried, evaluated = yield from problem.evaluate(candidates, self.archive)
        yield from self.admit(evaluated)
        for solution in (yield from problem.sample(problem.choose_uncertain(self.archive))):
            self.archive.update(solution)
        return Generation(number, tried, evaluated, self.archive.ranked())

    def admit(self, solutions: Sequence[S]) -> BatchGenerator[int]:
        """Admit solutions to the archive; returns their number. One that would displace an elite is evaluated
        as often as the elite was, and must stay better: the best of many first estimates is lucky."""
        admitted = 0
        while solutions:
            challengers = [s for s in solutions if self.archive.challenges(s)]
            entered = [self.archive.offer(s) for s in challengers]
            admitted += sum(entered)
            less_known = [s for s, inside in zip(challengers, entered, strict=True) if not inside]
            solutions = yield from self.problem.sample([s for s in less_known if self.archive.challenges(s)])
        return admitted
