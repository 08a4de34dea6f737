"""Small searches whose evaluation pretends to learn."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np

from eldir.controller import Controller
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.learning import LearningBatch, Shard, add_outcome
from eldir.evolution.paper.population import Robot
from eldir.evolution.paper.problem import PaperProblem
from eldir.evolution.problem import evaluate_here
from eldir.evolution.search import Generation, Search
from eldir.lattice import Lattice
from eldir.morphology import Morphology

SMALL = EvolutionConfig(Lattice(4, 6), population=12, generations=4, max_active=2, iterations=3, seed=5)


def evaluate(batch: LearningBatch, config: EvolutionConfig) -> SimpleNamespace:
    """A cheap stand-in for learning: small bodies are good, and the seed adds a little."""
    return pretend(batch.bodies, batch.seeds, config)


def learn(shard: Shard, config: EvolutionConfig) -> list[Robot]:
    """The same for a shard."""
    return add_outcome(shard.robots, pretend(shard.bodies, shard.seeds, config))


def pretend(bodies: Sequence[Morphology], seeds: Sequence[int], config: EvolutionConfig) -> SimpleNamespace:
    losses, controllers = [], []
    for body, seed in zip(bodies, seeds, strict=True):
        rng = np.random.default_rng(seed)
        end = -0.4 / len(body.positions) - 0.01 * rng.random()
        losses.append(np.linspace(0.0, end, config.iterations + 1))
        drawn = Controller.random(len(body.positions), body.motors, rng)
        # In the precision of the engine, which is what a run keeps.
        controllers.append(Controller(*(np.float32(getattr(drawn, k)) for k in ("w1", "b1", "w2", "b2"))))
    chaotic, rounded = np.array(seeds) % (config.iterations + 1), np.array(seeds) % 2
    return SimpleNamespace(
        losses=np.array(losses), controllers=controllers, chaotic_updates=chaotic, rounded_updates=rounded
    )


def search_for(config: EvolutionConfig, **options) -> Search:
    return Search(PaperProblem(config, **options))


def complete_generation(search: Search) -> Generation:
    """Go on to the end of the present generation."""
    generation = None
    while generation is None:
        batch = search.ask()
        if isinstance(batch, LearningBatch):
            outcome = add_outcome(batch.robots, evaluate(batch, search.problem.config))
        else:
            outcome = evaluate_here(batch)
        generation = search.tell(batch, outcome)
    return generation


def evolved(config: EvolutionConfig, **options) -> Search:
    search = search_for(config, **options)
    while not search.finished:
        complete_generation(search)
    return search


def fitness(search: Search) -> np.ndarray:
    """Of the survivors, best first."""
    return np.array([s.fitness for s in search.archive.ranked()])


def ids(search: Search) -> list[int]:
    return [s.number for s in search.archive.ranked()]
