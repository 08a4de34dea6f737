"""Evolution of bodies that one controller moves: the paper's selection, without learning of their own."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from training import Trainer, walks

import eldir
from eldir.evolution.archive import Archive
from eldir.evolution.problem import BatchGenerator, TrialBatch
from eldir.evolution.variation import make_offspring
from eldir.genotype import random_genotypes
from eldir.morphology import develop_all


@dataclass(frozen=True, eq=False)
class Walker:
    """A body, and how far it walks with the controller of its generation."""

    number: int
    parents: tuple[int, int]
    """Twice the number of its parent; -1 for random bodies."""
    genotype: eldir.Genotype
    fitness: float = -np.inf
    niche = ()
    samples = 1


@dataclass(frozen=True)
class UniversalProblem:
    """An evolution for `eldir.evolution.Search`. After each generation the controller is trained by
    `updates` on the survivors, which are evaluated again. Without updates it is frozen."""

    trainer: Trainer
    lattice: eldir.Lattice
    capacity: int
    generations: int
    updates: int
    seed: int

    def random(self, generation: int, rng: np.random.Generator) -> list[Walker]:
        drawn = random_genotypes(self.lattice, self.capacity, rng)
        return [Walker(i, (-1, -1), genotype) for i, genotype in enumerate(drawn)]

    def vary(self, archive: Archive[Walker], generation: int, rng: np.random.Generator) -> list[Walker]:
        """One offspring of each survivor, by the paper's mutation."""
        parents = archive.ranked()
        bodies = [parent.genotype for parent in parents]
        children, _ = make_offspring(self.lattice, bodies, rng)
        first = generation * self.capacity
        return [
            Walker(first + i, (parent.number, parent.number), child)
            for i, (parent, child) in enumerate(zip(parents, children, strict=True))
        ]

    def evaluate(
        self, candidates: Sequence[Walker], archive: Archive[Walker]
    ) -> BatchGenerator[tuple[list[Walker], list[Walker]]]:
        walked = yield from self._evaluate(candidates)
        return walked, [w for w in walked if np.isfinite(w.fitness)]

    def sample(self, solutions: Sequence[Walker]) -> BatchGenerator[list[Walker]]:
        """Train the controller on these bodies, and evaluate them again."""
        if not solutions:
            return []
        bodies = develop_all(self.lattice, [w.genotype for w in solutions])
        for _ in range(self.updates):
            self.trainer.update(bodies)
        return (yield from self._evaluate(solutions))

    def choose_uncertain(self, archive: Archive[Walker]) -> list[Walker]:
        return archive.ranked() if self.updates else []

    def _evaluate(self, walkers: Sequence[Walker]) -> BatchGenerator[list[Walker]]:
        lattice, controller = self.lattice, self.trainer.controller

        def trial(walkers: Sequence[Walker]) -> np.ndarray:
            return walks(controller, develop_all(lattice, [w.genotype for w in walkers]))

        fitness = yield TrialBatch(trial, walkers, (0.0, 1.0))
        return [replace(w, fitness=float(f)) for w, f in zip(walkers, fitness, strict=True)]


def run(search: eldir.evolution.Search[Any]) -> Iterator[list[Any]]:
    """The survivors after each generation, the best first."""
    while not search.finished:
        batch = search.ask()
        if generation := search.tell(batch, eldir.evolution.evaluate_here(batch)):
            yield list(generation.elites)


def describe(lattice: eldir.Lattice, survivors: Sequence[Any]) -> dict[str, float]:
    """Fitness [m] and diversity: the number of different bodies (up to a shift and a mirror image), in how
    many triangles two of them differ, and the size."""
    bodies = develop_all(lattice, [s.genotype for s in survivors])
    masks = np.stack([s.genotype.triangles.ravel() for s in survivors]).astype(float)
    n, filled = len(masks), masks.mean(axis=0)
    differing = (2 * filled * (1 - filled)).sum() * n / max(n - 1, 1)  # of two different survivors
    return {
        "best": survivors[0].fitness,
        "mean": float(np.mean([s.fitness for s in survivors])),
        "bodies": len({body.body_key for body in bodies}),
        "differing_triangles": float(differing),
        "springs": float(np.mean([len(body.springs) for body in bodies])),
    }
