"""Small evolutions of printed robots."""

from __future__ import annotations

import numpy as np

from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.genome import PrintedGenome, random_genomes
from eldir.lattice import Lattice
from eldir.morphology import Morphology

LATTICE = Lattice(6, 11)
SMALL = PrintedEvolutionConfig(lattice=LATTICE, offspring=4, generations=2, static_margin=0.0, seed=3)


def genomes(n: int, seed: int = 0, lattice: Lattice = LATTICE, motors: int = 2) -> list[PrintedGenome]:
    return random_genomes(lattice, n, np.random.default_rng(seed), motors, len(SMALL.timings))


def edges(body: Morphology, turn: float = 1.0) -> dict[frozenset[tuple[float, float]], bool]:
    """Whether each spring is a motor, by the places of its ends from the body's corner [mm]."""
    x = body.positions * [turn, 1.0]
    places = np.round(1e3 * (x - x.min(axis=0)), 6) + 0.0
    return {
        frozenset(map(tuple, places[pair].tolist())): bool(motor)
        for pair, motor in zip(body.springs, body.active, strict=True)
    }
