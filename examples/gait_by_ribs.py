"""Gait genes of a printed robot, searched by the archive and the CMA-MAE emitter of pyribs."""

import numpy as np
from ribs.archives import GridArchive
from ribs.emitters import EvolutionStrategyEmitter
from ribs.schedulers import Scheduler

import eldir
from eldir.built.gait import Gait
from eldir.evolution import VectorProblem

TEXT = {"triangles": ["0001100", "0001110", *2 * ["0" * 7]], "springs": f"{'0' * 23}1{'0' * 7}1{'0' * 17}"}
BODY = eldir.develop(eldir.Lattice(4, 7), eldir.Genotype.from_json(TEXT))
LOW, HIGH = np.array([0.0, 0.1, 0.1, 16.0]), np.array([1.0, 0.4, 0.4, 36.0])  # phase, two duties, period [s]


class TwoMotors(VectorProblem):
    """Walks by how long the gait heats, and by its period: genes from 0 to 1, ten steps of each measure."""

    def random(self, n, rng):
        return rng.random((n, len(LOW)))

    def vary(self, parents, rng):
        return np.clip(parents + 0.1 * rng.standard_normal(parents.shape), 0, 1)

    def evaluate(self, solutions, trial, seeds):
        genes = LOW + np.clip(solutions, 0, 1) * (HIGH - LOW)
        gaits = [Gait(period, np.array([0, phase]), duty) for phase, *duty, period in genes]
        walks = eldir.built.walk([eldir.built.build(BODY).coarse()] * len(gaits), gaits, cycles=1)
        return np.where(np.isfinite(walks), walks, -1.0)[:, None]

    def measures(self, solutions):
        return np.floor(9.99 * np.stack([solutions[:, 1:3].mean(axis=1), solutions[:, 3]], axis=1)).clip(0, 9)


problem, rng = TwoMotors(), np.random.default_rng(1)
archive = GridArchive(
    solution_dim=4, dims=[10, 10], ranges=[(0, 10)] * 2, learning_rate=0.1, threshold_min=-1
)
start = {"x0": problem.random(1, rng)[0], "sigma0": 0.3, "batch_size": 12, "bounds": [(0, 1)] * 4, "seed": 1}
emitter = EvolutionStrategyEmitter(archive, ranker="imp", selection_rule="mu", restart_rule="basic", **start)
scheduler = Scheduler(archive, [emitter])
for _ in range(5):
    solutions = scheduler.ask()
    scheduler.tell(
        problem.evaluate(solutions, 0, range(len(solutions)))[:, 0], problem.measures(solutions) + 0.5
    )
best = archive.best_elite["objective"]
print(f"{archive.stats.num_elites} cells; the best walks {best:+.2f} body lengths per five cycles")
