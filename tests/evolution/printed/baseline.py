"""Evolution of printed robots against random robots, judged by the same trials in the same processor time.

`python -m tests.evolution.printed.baseline 1 2 3` prints the table of docs/reference/evolution.md. The best
robots are looked at once more at the end, with samples that nothing was chosen by.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

from eldir.built.samples import NominalRobots, sampled_walks
from eldir.evolution.printed.configuration import PrintedEvolution
from eldir.evolution.printed.search import Candidate, PrintedSearch
from hardware.planning.workshop import workshop

GENERATIONS = 10
_FRESH, _SEED = 16, 77


class RandomRobots(PrintedSearch):
    """Random robots in every generation, as in the first one."""

    def _offspring(self, rng: np.random.Generator) -> list[Candidate]:
        return self._progenitors(rng)


def curve(search: PrintedSearch, seconds: float) -> list[tuple[float, float, int]]:
    """Processor time [s], worth of the best robot and number of elites that walk 1, after each generation."""
    began, found = time.process_time(), []
    while not search.finished and (spent := time.process_time() - began) < seconds:
        search.step()
        spent, ranked = time.process_time() - began, search.archive.ranked()
        found.append((spent, ranked[0].expected, sum(w.expected > 1 for w in ranked)))
        print(f"    {spent:.0f} s: best {ranked[0].expected:+.2f}, {found[-1][2]} above 1", flush=True)
    return found


def fresh(search: PrintedSearch, count: int) -> str:
    """The best robots, with samples that no choice was made by."""
    told = []
    for walker in search.archive.ranked()[:count]:
        body = walker.genome.body(search.config.lattice)
        hubs = replace(search.config.nominal, printed=search.config.printed.with_hubs())
        robots = NominalRobots(body, hubs)
        (walks,) = sampled_walks(robots, [walker.genome.gait(body, search.config.timings)], _FRESH, _SEED)
        fell = round(walks.fallen * _FRESH)
        told.append(f"{walks.expected:+.2f} +- {walks.error:.2f}{f' ({fell} fell)' * bool(fell)}")
    return ", ".join(told)


def main(seeds: list[int]) -> None:
    given = workshop()
    for seed in seeds:
        config = PrintedEvolution(
            generations=GENERATIONS, seed=seed, printed=given.printed, springs=given.springs,
            timings=given.timings,
        )  # fmt: skip
        print(f"seed {seed}, evolution")
        evolved = PrintedSearch(config, given.refused)
        spent = curve(evolved, np.inf)[-1][0]
        print(f"  fresh samples: {fresh(evolved, 5)}", flush=True)
        print(f"seed {seed}, random robots")
        drawn = RandomRobots(config, given.refused)
        curve(drawn, spent)
        print(f"  fresh samples: {fresh(drawn, 5)}", flush=True)


if __name__ == "__main__":
    main([int(s) for s in sys.argv[1:]] or [1, 2, 3])
