"""Bodies that hold their head high while their motors do anything: an own problem, evolved and read again."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import eldir
from eldir.evolution import ProblemConfig, ProblemRun, VectorProblem
from eldir.evolution.loop import run_generations
from eldir.genotype import repair_bodies, unstack

LATTICE = eldir.Lattice(rows=4, columns=6)
TRIANGLES, SPRINGS = LATTICE.rows * LATTICE.columns, len(LATTICE.springs)


class TallRobots(VectorProblem):
    """A number above 0.5 is a filled triangle, or a spring that is a motor."""

    shares = (1.0, 0.5)  # half of the bodies that stand in a short rollout get a long one
    max_samples = 8

    def random(self, n: int, rng: np.random.Generator) -> np.ndarray:
        return rng.random((n, TRIANGLES + SPRINGS))

    def vary(self, parents: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        changed = rng.random(parents.shape) < 2 / parents.shape[1]
        return np.where(changed, rng.random(parents.shape), parents)

    def evaluate(self, solutions: np.ndarray, trial: int, seeds: Sequence[int]) -> np.ndarray:
        """Height of the highest mass at the end [m], with two random controllers each."""
        bodies = [body for body in self.bodies(solutions) for _ in range(2)]
        rngs = [np.random.default_rng([seed, sample]) for seed in seeds for sample in range(2)]
        drawn = [
            eldir.Controller.random(len(body.positions), body.motors, rng)
            for body, rng in zip(bodies, rngs, strict=True)
        ]
        rollouts = eldir.simulate(bodies, drawn, eldir.Scene().replace(steps=(100, 400)[trial]))
        return np.array([r.positions[-1, :, 1].max() for r in rollouts]).reshape(-1, 2)

    def measures(self, solutions: np.ndarray) -> np.ndarray:
        """Number of masses in steps of four."""
        return np.array([[len(body.positions) // 4] for body in self.bodies(solutions)])

    def bodies(self, solutions: np.ndarray) -> list[eldir.Morphology]:
        filled, genes = solutions[:, :TRIANGLES], solutions[:, TRIANGLES:]
        filled = filled >= np.minimum(0.5, filled.max(axis=1, keepdims=True))  # at least one
        triangles = repair_bodies(LATTICE, filled.reshape(-1, LATTICE.rows, LATTICE.columns))
        genes = np.where(LATTICE.expressed_springs(triangles), genes, 0.0)
        springs = genes >= np.minimum(0.5, genes.max(axis=1, keepdims=True))
        return [eldir.develop(LATTICE, genotype) for genotype in unstack(triangles, springs)]


if __name__ == "__main__":
    config = ProblemConfig("tall", offspring=16, generations=4, seed=1)
    run = ProblemRun.create(Path(tempfile.mkdtemp()) / "run", config)
    run_generations(run, run.restore(TallRobots()), run.workers())
    for elite in run.read_last_elites():
        print(f"about {4 * elite.niche[0]} masses: {elite.fitness:.3f} +- {elite.error:.3f} m")
