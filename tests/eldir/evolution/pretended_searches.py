"""Small searches whose evaluation pretends to learn."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np

from eldir.controller import Controller
from eldir.evolution.population import Robots
from eldir.evolution.search import EvolutionConfig, Search
from eldir.lattice import Lattice
from eldir.morphology import Morphology

SMALL = EvolutionConfig(Lattice(4, 6), population=12, generations=4, max_active=2, iterations=3, seed=5)


def evaluate(robots: Robots, config: EvolutionConfig) -> SimpleNamespace:
    """A cheap stand-in for learning: small bodies are good, and the seed adds a little."""
    return pretend(robots.morphologies(config.lattice), robots.seeds, config)


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


def evolved(config: EvolutionConfig, **options) -> Search:
    search = Search(config, **options)
    while not search.finished:
        robots = search.ask()
        search.tell(robots, evaluate(robots, config))
    return search
