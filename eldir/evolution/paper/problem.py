"""The genetic algorithm: bodies compete by how well they learn (paper, Sect. Genetic algorithm).

Generation 0 consists of random progenitors. Each survivor has one offspring, and the best of parents and
offspring survive: an archive of one niche with room for the population.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from eldir.built.robot import build, find_shape_fault, static_margin
from eldir.built.screening import simulate_soft_walks
from eldir.core.records import FloatArray, IntArray
from eldir.errors import EldirError
from eldir.evolution.archive import Archive
from eldir.evolution.paper.configuration import EvolutionConfig, printed_terrain, robot_seed
from eldir.evolution.paper.encoding import make_encoding
from eldir.evolution.paper.learning import LearningBatch
from eldir.evolution.paper.population import Robot, is_valid
from eldir.evolution.problem import BatchGenerator, TrialBatch
from eldir.genotype import Genotype
from eldir.morphology import Morphology, develop, develop_all

AcceptBody = Callable[[Morphology], bool]
"""A further condition on new bodies, in addition to the configuration. The run folder does not contain it."""
WalkFunction = Callable[[Sequence[Morphology]], FloatArray]
"""A function that gives the walk of printed bodies, for the second stage."""
_Born = tuple[Any, Genotype]  # a genome and its body
_ATTEMPTS = 200  # batches sampled for bodies that are accepted


class PaperProblem:
    """Bodies that learn in the paper's scene."""

    def __init__(
        self, config: EvolutionConfig, accept: AcceptBody | None = None, walks: WalkFunction | None = None
    ) -> None:
        self.config = config
        self.seed, self.generations, self.capacity = config.seed, config.generations, config.population
        self._encoding, self._accept = make_encoding(config), accept
        self._walks = walks or partial(simulate_soft_walks, terrain=printed_terrain(config.scene))

    def random(self, generation: int, rng: np.random.Generator) -> list[Robot]:
        c = self.config
        found: list[_Born] = []
        for _ in range(_ATTEMPTS):
            drawn = self._encoding.random(c.population - len(found), rng)
            found += [born for born in self._develop(drawn) if self._is_accepted(born[1])]
            if len(found) == c.population:
                return self._number(generation, found, np.full((c.population, 2), -1))
        raise _too_few_bodies_error(c.population - len(found))

    def vary(self, archive: Archive[Robot], generation: int, rng: np.random.Generator) -> list[Robot]:
        """One offspring of each survivor."""
        survivors = archive.ranked()
        genomes = [r.genotype if r.genome is None else r.genome for r in survivors]
        ids = np.array([r.number for r in survivors])
        found: dict[int, _Born] = {}
        parents = np.zeros((len(survivors), 2), np.int64)
        for _ in range(_ATTEMPTS):
            drawn, of = self._encoding.make_offspring(genomes, rng)
            for i, born in enumerate(self._develop(drawn)):
                if i not in found and self._is_accepted(born[1]):
                    found[i], parents[i] = born, ids[of[i]]
            if len(found) == len(survivors):
                return self._number(generation, [found[i] for i in range(len(found))], parents)
        raise _too_few_bodies_error(len(survivors) - len(found))

    def _develop(self, genomes: Sequence[Any]) -> list[_Born]:
        return list(zip(genomes, self._encoding.develop(genomes), strict=True))

    def _number(self, generation: int, born: Sequence[_Born], parents: IntArray) -> list[Robot]:
        first, seed = generation * self.config.population, self.config.seed
        return [
            Robot(
                first + i,
                (int(one), int(other)),
                robot_seed(seed, generation, i),
                genotype,
                genome=None if genome is genotype else genome,
            )
            for i, ((genome, genotype), (one, other)) in enumerate(zip(born, parents, strict=True))
        ]

    def _is_accepted(self, genotype: Genotype) -> bool:
        c = self.config
        if c.static_margin is None and not c.buildable and self._accept is None:
            return True
        body = develop(c.lattice, genotype)
        if c.static_margin is not None and static_margin(build(body)) < c.static_margin:
            return False
        if c.buildable and find_shape_fault(build(body)):
            return False
        return self._accept is None or bool(self._accept(body))

    def evaluate(
        self, candidates: Sequence[Robot], archive: Archive[Robot]
    ) -> BatchGenerator[tuple[list[Robot], list[Robot]]]:
        """All learn; with a second stage, those that would survive walk as built. Raises `EldirError` where
        no robot of the first generation is stable."""
        progenitors = {r.number: r for r in archive.ranked()} if self.config.inherit else {}
        learned: list[Robot] = yield LearningBatch(candidates, self.config, progenitors)
        losses = np.stack([robot.losses for robot in learned])
        valid = is_valid(losses, self.config.training.jump_threshold)
        if self.config.second_stage:
            learned = yield from self._walk_survivors(learned, valid, archive)
        standing = [r for r, ok in zip(learned, valid, strict=True) if ok and r.walk != -np.inf]
        if not (standing or len(archive)):
            raise EldirError(
                "no robot of the first generation was stable",
                code="evolution.none-stable",
                expected="at least one whose losses are finite and steady",
                remedy="use a larger population, another seed or a smaller step",
            )
        return learned, standing

    def _walk_survivors(
        self, learned: list[Robot], valid: np.ndarray, archive: Archive[Robot]
    ) -> BatchGenerator[list[Robot]]:
        """The same robots, with the walks as built of all that would survive, including those that replace
        fallen ones."""
        while True:
            standing = [r for r, ok in zip(learned, valid, strict=True) if ok and r.walk != -np.inf]
            survivors = Archive([*archive.ranked(), *standing], self.capacity).ranked()
            unknown = {r.number for r in survivors if r.walk is None} & {r.number for r in learned}
            places = [i for i, r in enumerate(learned) if r.number in unknown]
            if not places:
                return learned
            bodies = develop_all(self.config.lattice, [learned[i].genotype for i in places])
            walks: FloatArray = yield TrialBatch(self._walks, bodies, (1.0, 1.0))
            for i, walk in zip(places, walks, strict=True):
                learned[i] = replace(learned[i], walk=float(walk))

    def sample(self, solutions: Sequence[Robot]) -> BatchGenerator[list[Robot]]:
        """None: what a robot learns is known exactly."""
        yield from ()
        return []

    def choose_uncertain(self, archive: Archive[Robot]) -> list[Robot]:
        """None: what a robot learns is known exactly."""
        return []


def _too_few_bodies_error(missing: int) -> EldirError:
    return EldirError(
        "too few bodies are accepted",
        code="evolution.too-few-bodies",
        expected=f"one accepted body for every place within {_ATTEMPTS} attempts",
        found=f"{missing} places still empty",
        remedy="relax the condition or enlarge the lattice",
    )
