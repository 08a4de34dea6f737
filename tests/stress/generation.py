"""What a generation costs: `python -m tests.stress.generation ROBOTS FOLDER`.

Processor time of the engine's kernel beside that of everything else, so that a busy machine does not
matter, and peak memory.
"""

import resource
import sys
import time
from pathlib import Path

from scipy.stats import spearmanr

from eldir.engine import batch
from eldir.evolution.loop import run_generations
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.history import read_history
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.workers import LocalWorkers
from eldir.lattice import Lattice

_engine = 0.0


def measure(robots: int, folder: Path) -> None:
    kernel = batch.learning_kernel
    batch.learning_kernel = lambda precision: _timed(kernel(precision))
    began, used = time.monotonic(), time.process_time()
    run = RunFolder.create(folder, EvolutionConfig(Lattice(), population=robots, generations=0, seed=1))
    run_generations(run, run.restore(), LocalWorkers())
    wall, used = time.monotonic() - began, time.process_time() - used
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{robots} robots: {wall:.0f} s, processor {used:.0f} s, of which the kernel {_engine:.0f} s")
    print(f"outside the kernel {100 * (1 - _engine / used):.1f} %; peak {memory:.2f} GB")
    people = read_history(run).progenitors
    rho = spearmanr(people.sizes, people.fitness)
    print(f"springs {people.sizes.mean():.2f} +- {people.sizes.std():.2f}, largest {people.sizes.max()}")
    print(f"active {people.active.mean():.4f} +- {people.active.std():.4f}")
    walk = people.fitness
    print(f"fitness {walk.mean():.4f} +- {walk.std():.4f} m, best {walk.max():.3f}")
    print(f"rho {rho.statistic:.3f} (p = {rho.pvalue:.2g}), {robots - len(people.sizes)} discarded")


def _timed(kernel):
    def call(*arguments):
        global _engine  # noqa: PLW0603
        before = time.process_time()
        kernel(*arguments)
        _engine += time.process_time() - before

    return call


if __name__ == "__main__":
    measure(int(sys.argv[1]), Path(sys.argv[2]))
