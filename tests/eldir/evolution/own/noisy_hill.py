"""A cheap problem with an error: a hill, climbed by noisy samples."""

from collections.abc import Sequence

import numpy as np

from eldir.evolution.own.vectors import ProblemConfig, VectorProblem

CONFIG = ProblemConfig("hill", offspring=12, generations=4, seed=7)


class NoisyHill(VectorProblem):
    """The first trial knows one coordinate. Niches are quarters of the second one."""

    shares = (1.0, 0.5, 0.25)
    max_samples = 12

    def random(self, n: int, rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(-1, 1, (n, 2))

    def vary(self, parents: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return np.clip(parents + 0.2 * rng.standard_normal(parents.shape), -1, 1)

    def evaluate(self, solutions: np.ndarray, trial: int, seeds: Sequence[int]) -> np.ndarray:
        noise = np.array([np.random.default_rng(seed).normal(0, 0.1, 4) for seed in seeds])
        return self.height(solutions[:, : min(1 + trial, 2)])[:, None] + noise

    def measures(self, solutions: np.ndarray) -> np.ndarray:
        return np.floor(2 * solutions[:, 1:]).astype(int)

    @staticmethod
    def height(solutions: np.ndarray) -> np.ndarray:
        return 1.0 - ((solutions - 0.3) ** 2).sum(axis=1)
