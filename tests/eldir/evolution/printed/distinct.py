"""How many really different robots a run has found, apart from the archive's kinds.

`python -m tests.eldir.evolution.printed.distinct RUN 0.8` goes through all robots that had a first look, the
best first, and keeps each one whose body shares at most 80 % of its springs with every body kept so far. The
kept ones then walk with samples that nothing was chosen by.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from eldir.built.samples import NominalRobots, sample_walks
from eldir.evolution import tables
from eldir.evolution.printed.genome import PrintedGenome
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.morphology import Morphology
from eldir_cad.shortlist.ranking import spring_overlap
from tests.eldir.evolution.printed.baseline import _FRESH, _SEED

_MOST, _ASKED = 40, 1.2


def main(path: Path, most_shared: float) -> None:
    run = PrintedRun.open(path)
    looked: list[tuple[float, PrintedGenome]] = []
    for generation in range(run.complete_generations()[-1][0] + 1):
        table = tables.read(run.generation_file(generation))
        for genome, walks in zip(run._genomes(table), tables.rows(table, "walks"), strict=True):
            if len(walks) and walks.mean() > _ASKED:
                looked.append((float(walks.mean()), genome))
    looked.sort(key=lambda each: -each[0])
    print(f"{len(looked)} robots above {_ASKED} at their first look")
    kept: list[Morphology] = []
    good = 0
    hubs = replace(run.config.nominal, printed=run.config.printed.with_hubs())
    for first, genome in looked:
        body = genome.body(run.config.lattice)
        if len(kept) == _MOST or any(spring_overlap(body, other) > most_shared for other in kept):
            continue
        kept.append(body)
        robots = NominalRobots(body, hubs)
        (walks,) = sample_walks(robots, [genome.gait(body, run.config.timings)], _FRESH, _SEED)
        walked = abs(walks.expected)  # who walks backwards was looked at as its mirror image
        good += walked > _ASKED
        fresh = f"{walked:+.2f} +- {walks.error:.2f}, {round(walks.fallen * _FRESH)} fell"
        print(f"{len(kept):3d}: {first:.2f} at first, fresh {fresh}; {good} above {_ASKED}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
