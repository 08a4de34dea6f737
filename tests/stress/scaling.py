"""How a generation scales: `python -m tests.stress.scaling`.

Measures learning on 1, 2, 4 ... threads of this machine, turn by turn: by the clock, and by processor time,
which tells what threads cost each other also where other work takes their cores. Then lays the shards of a
generation of 10 000 on many processes as Ray does: whoever is free takes the next. A robot's time is taken
to grow with its springs.
"""

import heapq
import os
import time

import numpy as np

from eldir.evolution.cluster import shard_size
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.problem import PaperProblem
from eldir.evolution.search import Search
from eldir.learning import learn

_ROBOTS, _UPDATES, _TURNS = 32, 4, 5


def measured() -> dict[int, tuple[float, float]]:
    """Robot-iterations a second and a processor second for numbers of threads, medians of some turns."""
    config = EvolutionConfig(population=_ROBOTS, generations=0, seed=1)
    bodies = Search(PaperProblem(config)).ask().bodies
    counts = [n for n in (1, 2, 4, 8, 16, 32, 64) if n <= (os.cpu_count() or 1)]
    rates: dict[int, list[tuple[float, float]]] = {n: [] for n in counts}
    for turn in range(_TURNS + 1):
        for threads in counts:
            os.environ["ELDIR_THREADS"] = str(threads)
            began, used = time.monotonic(), time.process_time()
            learn(bodies, config.scene, _UPDATES)
            spent = time.monotonic() - began, time.process_time() - used
            if turn:  # the first compiles
                rates[threads].append(tuple(_ROBOTS * (_UPDATES + 1) / s for s in spent))
    return {n: tuple(np.median(r, axis=0)) for n, r in rates.items()}


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
    for threads, (clock, processor) in rates.items():
        told = f"{clock:.0f} robot-iterations a second, {processor:.0f} a processor second"
        print(f"{threads} threads: {told}, {100 * processor / rates[1][1]:.0f} % of one thread's")
    config = EvolutionConfig(population=10_000, generations=0, seed=1)
    springs = np.array([len(b.springs) for b in Search(PaperProblem(config)).ask().bodies])
    for processes in (1, 4, 16, 64, 250, 1000, 4000):
        units = makespan(springs, processes)
        busy = len(springs) / (units * processes)
        seconds = units * 36 / rates[1][1]
        print(f"{processes} processes: {seconds:.1f} s a generation of 10 000 x 35, {100 * busy:.0f} % busy")


if __name__ == "__main__":
    main()
