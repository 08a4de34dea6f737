"""How much the cheaper trials err on robots that walk: the table of docs/reference/evolving-for-building.md.

`python -m tests.evolution.printed.trial_table RUN...` compares the mean walks of eight samples of the elites
with those of robots with hubs over five cycles.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from eldir.built.gait import Gait, free_lengths_of_all
from eldir.built.robot import build
from eldir.built.samples import NominalRobots
from eldir.built.walking import displacements
from eldir.core.records import FloatArray
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.printed.trials import SOFT, counted
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters

SAMPLES = 8
_SEED = 4711
_TRUTH = "hubs, 5 cycles"
_WALKS = 0.5  # elites that walk less tell nothing about walkers [body lengths per five cycles]


def mean_walk(body: Morphology, gait: Gait, nominal: RobotParameters, cycles: int) -> float:
    samples = NominalRobots(body, nominal).samples(SAMPLES, _SEED)
    heated = [(gait, s.springs_of(body.motors)) for s in samples]
    tables = free_lengths_of_all(heated, cycles)
    robots = [build(body, s) for s in samples]
    return float(counted(displacements(robots, tables, cycles, nominal.free_lengths)).mean())


def main(folders: list[Path]) -> None:
    walkers = []
    for folder in folders:
        run = PrintedRun.open(folder)
        for walker in run.restore().archive.ranked():
            body = walker.genome.body(run.config.lattice)
            if walker.expected > _WALKS:
                walkers.append((body, walker.genome.gait(body, run.config.timings), run.config.nominal))
    found: dict[str, FloatArray] = {}
    for name, tension, cycles, hubs in (
        (_TRUTH, None, 5, True),
        ("hubs, 1 cycle", None, 1, True),
        ("hubs, strips of 40 kN/m, 1 cycle", 40e3, 1, True),
        ("hubs, strips of 20 kN/m, 1 cycle", SOFT, 1, True),
        ("pins, 5 cycles", None, 5, False),
        ("pins, 1 cycle", None, 1, False),
        ("pins, strips of 20 kN/m, 1 cycle", SOFT, 1, False),
    ):
        began, walks = time.process_time(), []
        for body, gait, nominal in walkers:
            printed = nominal.printed if tension is None else replace(nominal.printed, tension=tension)
            printed = printed.with_hubs() if hubs else printed
            walks.append(mean_walk(body, gait, replace(nominal, printed=printed), cycles))
        found[name] = np.array(walks)
        spent = (time.process_time() - began) / len(walkers) / SAMPLES
        off = found[name] - found[_TRUTH]
        alike = np.corrcoef(found[name], found[_TRUTH])[0, 1]
        rms = np.sqrt((off**2).mean())
        print(f"| {name} | {1e3 * spent:.0f} | {off.mean():+.2f} | {rms:.2f} | {alike:.2f} |", flush=True)
    print(f"{len(walkers)} elites, walks from {found[_TRUTH].min():+.2f} to ", end="")
    print(f"{found[_TRUTH].max():+.2f}")


if __name__ == "__main__":
    main([Path(p) for p in sys.argv[1:]])
