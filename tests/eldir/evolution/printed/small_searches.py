"""Small evolutions of printed robots."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TypeVar

import numpy as np

from eldir.built.gait import Gait
from eldir.core.records import FloatArray
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.genome import PrintedGenome, random_genomes
from eldir.evolution.problem import Batch, TrialBatch
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop

T = TypeVar("T")
LATTICE = Lattice(6, 11)
SMALL = PrintedEvolutionConfig(lattice=LATTICE, offspring=4, generations=2, static_margin=0.0, seed=3)

_SMALL_LATTICE = Lattice(3, 6)
BODY = develop(_SMALL_LATTICE, random_genotypes(_SMALL_LATTICE, 1, np.random.default_rng(10), 2)[0])
GAIT = Gait(20.0, np.array([0.0, 0.125]), np.full(2, 0.3))  # with it the body walks a little


def genomes(n: int, seed: int = 0, lattice: Lattice = LATTICE, motors: int = 2) -> list[PrintedGenome]:
    return random_genomes(lattice, n, np.random.default_rng(seed), motors, len(SMALL.timings))


def evaluate(batch: Batch) -> FloatArray:
    """The rows of a batch, from its own trial."""
    assert isinstance(batch, TrialBatch)
    return batch.trial(batch.tasks, *batch.arguments)


def run_to_end(
    course: Generator[Batch, FloatArray, T], answer: Callable[[Batch], FloatArray] = evaluate
) -> T:
    """What a course of trials returns, with the outcomes that `answer` gives."""
    try:
        batch = next(course)
        while True:
            batch = course.send(answer(batch))
    except StopIteration as end:
        found: T = end.value
        return found


def edges(body: Morphology, turn: float = 1.0) -> dict[frozenset[tuple[float, float]], bool]:
    """Whether each spring is a motor, by the places of its ends from the body's corner [mm]."""
    x = body.positions * [turn, 1.0]
    places = np.round(1e3 * (x - x.min(axis=0)), 6) + 0.0
    return {
        frozenset(map(tuple, places[pair].tolist())): bool(motor)
        for pair, motor in zip(body.springs, body.active, strict=True)
    }
