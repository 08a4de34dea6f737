"""The robots of all measurements: always the same ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from eldir.genotype import Genotype, fill, random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop

_SMALL_SPRINGS = 62


def big(n: int, seed: int = 1) -> list[Morphology]:
    """Random bodies on the paper's lattice: 176 springs on average, half of them motors."""
    lattice = Lattice()
    return [develop(lattice, g) for g in random_genotypes(lattice, n, np.random.default_rng(seed))]


def small(n: int, seed: int = 1) -> list[Morphology]:
    """Bodies on the same lattice, grown triangle by triangle until they have 62 springs or a few more."""
    lattice, rng = Lattice(), np.random.default_rng(seed)
    return [develop(lattice, _grown(lattice, rng, _SMALL_SPRINGS)) for _ in range(n)]


POPULATIONS: dict[str, Callable[[int], list[Morphology]]] = {"big": big, "small": small}


def without_motors(body: Morphology) -> Morphology:
    """The same body with all springs passive."""
    return replace(body, active=np.zeros(len(body.springs), bool))


def _grown(lattice: Lattice, rng: np.random.Generator, springs: int) -> Genotype:
    body = np.zeros((lattice.rows, lattice.columns), bool)
    body[rng.integers(lattice.rows), rng.integers(lattice.columns)] = True
    while lattice.expressed_springs(body).sum() < springs:
        beside = np.zeros_like(body)
        beside[1:] |= body[:-1]
        beside[:-1] |= body[1:]
        beside[:, 1:] |= body[:, :-1]
        beside[:, :-1] |= body[:, 1:]
        body[tuple(rng.choice(np.argwhere(beside & ~body)))] = True
    motors = rng.random(len(lattice.springs)) < 0.5
    return Genotype(fill(lattice, body), motors)
