"""Evolution of printed robots against random robots, judged by the same trials in the same processor time.

`python -m tests.eldir.evolution.printed.baseline FILE.png 1 2 3` prints what the table of
docs/reference/evolving-for-building.md says and draws its picture. The best robots are looked at once more at
the end, with samples that nothing was chosen by.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from eldir.built.samples import NominalRobots, sample_walks
from eldir.evolution.archive import Archive
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.problem import Candidate, PrintedProblem
from eldir.evolution.printed.walker import Walker
from eldir.evolution.problem import evaluate_here
from eldir.evolution.search import Search
from eldir_hardware.planning.workshop import make_workshop

GENERATIONS = 10
_FRESH, _SEED = 16, 77


Curve = list[tuple[float, float, int]]
"""Processor time [s], expected walk of the best robot and number of elites that walk 1, by generation."""


class RandomRobots(PrintedProblem):
    """Random robots in every generation, as in the first one."""

    def vary(self, archive: Archive[Walker], generation: int, rng: np.random.Generator) -> list[Candidate]:
        return self.random(generation, rng)


def curve(search: Search[Walker], seconds: float) -> Curve:
    """What a search finds in so much processor time."""
    began = time.process_time()
    found: Curve = []
    while not search.finished and (spent := time.process_time() - began) < seconds:
        generation = None
        while generation is None:
            batch = search.ask()
            generation = search.tell(batch, evaluate_here(batch))
        spent, ranked = time.process_time() - began, search.archive.ranked()
        found.append((spent, ranked[0].expected, sum(w.expected > 1 for w in ranked)))
        print(f"    {spent:.0f} s: best {ranked[0].expected:+.2f}, {found[-1][2]} above 1", flush=True)
    return found


def fresh(search: Search[Walker], config: PrintedEvolutionConfig, count: int) -> str:
    """The best robots, with samples that no choice was made by."""
    told = []
    for walker in search.archive.ranked()[:count]:
        body = walker.genome.body(config.lattice)
        hubs = replace(config.nominal, printed=config.printed.with_hubs())
        robots = NominalRobots(body, hubs)
        (walks,) = sample_walks(robots, [walker.genome.gait(body, config.timings)], _FRESH, _SEED)
        fell = round(walks.fallen * _FRESH)
        told.append(f"{walks.expected:+.2f} +- {walks.error:.2f}{f' ({fell} fell)' * bool(fell)}")
    return ", ".join(told)


def drawn(curves: Mapping[tuple[str, int], Curve]) -> Figure:
    """Best walk and number of kinds that walk, over processor time."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    panels = figure.subplots(1, 2)
    for (kind, seed), found in curves.items():
        line, size = ("-", 5.0) if kind == "evolution" else (":", 2.5)
        seconds, *columns = zip(*found, strict=True)
        for axes, column in zip(panels, columns, strict=True):
            axes.plot(
                seconds,
                column,
                ls=line,
                marker="o",
                ms=size,
                color=f"C{seed - 1}",
                label=f"{kind}, seed {seed}",
            )
    names = (
        "best robot's expected walk\n[body lengths per five cycles]",
        "kinds of bodies that walk more than 1",
    )
    for axes, name in zip(panels, names, strict=True):
        axes.set(xlabel="processor time [s]", ylabel=name)
        axes.set_ylim(0)
    panels[1].legend(loc="upper left", bbox_to_anchor=(1, 1.02), fontsize="small")
    return figure


def main(picture: Path, seeds: list[int]) -> None:
    given = make_workshop()
    curves: dict[tuple[str, int], Curve] = {}
    for seed in seeds:
        config = PrintedEvolutionConfig(
            generations=GENERATIONS, seed=seed, printed=given.printed, springs=given.springs,
            timings=given.timings,
        )  # fmt: skip
        seconds = np.inf  # evolution goes to its end, random robots as long
        for kind, problem in (("evolution", PrintedProblem), ("random", RandomRobots)):
            search = Search(problem(config, given.rejection_reason))
            print(f"seed {seed}, {kind}")
            curves[kind, seed] = curve(search, seconds)
            seconds = min(seconds, curves[kind, seed][-1][0])
            print(f"  fresh samples: {fresh(search, config, 5)}", flush=True)
    drawn(curves).savefig(picture, dpi=100)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [int(s) for s in sys.argv[2:]] or [1, 2, 3])
