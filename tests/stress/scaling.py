"""How a generation scales: `python -m tests.stress.scaling`.

Measures learning on 1, 2, 4 ... threads of this machine, turn by turn, and lays the shards of a generation
of 10 000 on many processes as Ray does: whoever is free takes the next. A robot's time is taken to grow
with its springs.
"""

import heapq
import os
import time

import numpy as np

from eldir.cluster import shard_size
from eldir.evolution import Evolution, Search
from eldir.learning import learn

_ROBOTS, _UPDATES, _TURNS = 32, 4, 5


def measured() -> dict[int, float]:
    """Robot-iterations a second for numbers of threads, best of some turns."""
    config = Evolution(population=_ROBOTS, generations=0, seed=1)
    bodies = Search(config).ask().morphologies(config.lattice)
    counts = [n for n in (1, 2, 4, 8, 16, 32, 64) if n <= (os.cpu_count() or 1)]
    best = dict.fromkeys(counts, 0.0)
    for turn in range(_TURNS + 1):
        for threads in counts:
            os.environ["ELDIR_THREADS"] = str(threads)
            began = time.monotonic()
            learn(bodies, config.scene, _UPDATES)
            rate = _ROBOTS * (_UPDATES + 1) / (time.monotonic() - began)
            if turn:  # the first compiles
                best[threads] = max(best[threads], rate)
    return best


def makespan(springs: np.ndarray, processes: int) -> float:
    """Time of a generation on processes of one thread, in units of the mean robot's time."""
    cost = np.sort(springs)[::-1] / springs.mean()
    size = shard_size(len(cost), processes, 1)
    free = [0.0] * processes
    for first in range(0, len(cost), size):
        heapq.heappush(free, heapq.heappop(free) + cost[first : first + size].sum())
    return max(free)


def main() -> None:
    rates = measured()
    for threads, rate in rates.items():
        share = 100 * rate / (threads * rates[1])
        print(f"{threads} threads: {rate:.0f} robot-iterations a second, {share:.0f} % of {threads} x one")
    config = Evolution(population=10_000, generations=0, seed=1)
    springs = np.array([len(b.springs) for b in Search(config).ask().morphologies(config.lattice)])
    for processes in (1, 4, 16, 64, 250, 1000, 4000):
        units = makespan(springs, processes)
        busy = len(springs) / (units * processes)
        seconds = units * 36 / rates[1]
        print(f"{processes} processes: {seconds:.1f} s a generation of 10 000 x 35, {100 * busy:.0f} % busy")


if __name__ == "__main__":
    main()
