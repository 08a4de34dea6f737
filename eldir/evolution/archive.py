"""The archive of a search: the best solutions of every niche (MAP-Elites, Mouret and Clune 2015).

A niche is a cell of measures. With one niche and room for a whole population it is the survivors of a genetic
algorithm. Fitness may be estimated from samples, so a solution that is evaluated again may lose its rank.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterable
from typing import Generic, Protocol, TypeVar

import numpy as np


class Solution(Protocol):
    """What an archive knows of a solution that has been evaluated."""

    @property
    def number(self) -> int:
        """Unique in a run; the older of two solutions has the smaller one."""

    @property
    def niche(self) -> tuple[int, ...]:
        """The cell of its measures."""

    @property
    def fitness(self) -> float:
        """The objective, which is maximised, or the lower confidence bound of its estimate."""

    @property
    def samples(self) -> int:
        """Number of samples from which fitness is estimated."""


S = TypeVar("S", bound=Solution)


class Archive(Generic[S]):
    """The best solutions of every niche, at most `capacity` in each."""

    def __init__(self, elites: Iterable[S] = (), capacity: int = 1) -> None:
        self._capacity = capacity
        self._niches: dict[tuple[int, ...], list[S]] = {}
        for solution in elites:
            self.offer(solution)

    def __len__(self) -> int:
        return sum(map(len, self._niches.values()))

    def ranked(self) -> list[S]:
        """All elites, the best first; of equal ones, the older first."""
        return sorted((s for own in self._niches.values() for s in own), key=_rank)

    def incumbent(self, niche: tuple[int, ...]) -> float:
        """Fitness that a solution must exceed to enter a niche; minus infinity if there is room."""
        own = self._niches.get(niche, [])
        return own[-1].fitness if len(own) == self._capacity else -np.inf

    def challenges(self, solution: S) -> bool:
        """Whether the estimated fitness of a solution is above that of the incumbent of its niche."""
        return solution.fitness > self.incumbent(solution.niche)

    def offer(self, solution: S) -> bool:
        """Admit a solution that is fitter than the incumbent of its niche and has at least as many samples: a
        few lucky samples do not displace what many samples have shown."""
        own = self._niches.get(solution.niche, [])
        is_full = len(own) == self._capacity
        if not self.challenges(solution) or (is_full and solution.samples < own[-1].samples):
            return False
        insort(own, solution, key=_rank)
        del own[self._capacity :]
        self._niches[solution.niche] = own
        return True

    def update(self, solution: S) -> None:
        """Replace an elite by itself with further samples."""
        own = self._niches[solution.niche]
        if solution.number in (s.number for s in own):
            others = [s for s in own if s.number != solution.number]
            self._niches[solution.niche] = sorted([*others, solution], key=_rank)


def _rank(solution: Solution) -> tuple[float, int]:
    return -solution.fitness, solution.number
