"""Small evolutions of printed robots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eldir.evolution.printed.configuration import PrintedEvolution
from eldir.evolution.printed.genome import PrintedGenome
from eldir.evolution.printed.variation import random_genomes
from eldir.lattice import Lattice

LATTICE = Lattice(3, 6)
SMALL = PrintedEvolution(lattice=LATTICE, offspring=4, generations=2, static_margin=0.0, seed=3)


def genomes(n: int, seed: int = 0, lattice: Lattice = LATTICE, motors: int = 2) -> list[PrintedGenome]:
    return random_genomes(lattice, n, np.random.default_rng(seed), motors, len(SMALL.timings))


def with_timings(*timings: tuple[float, float]) -> PrintedEvolution:
    return replace(SMALL, timings=timings)
