"""`python -m benchmarks.coarse_robots`: processor time and error of walks of coarse robots (decision 56).

Robots that walk and their samples are those of `eldir benchmark built`, and of two more seeds. A row is one
way to make them coarse, compared with the robots as they are, five cycles each.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import numpy as np

from eldir.benchmark.built import REAL, Simplification, Walker, mean_walk, walkers
from eldir.benchmark.measurement import limit_threads
from eldir.core.records import FloatArray

SEEDS = (4711, 11, 12)
WAYS = {
    "as they are": Simplification(True, 5),
    "inertia x 4": Simplification(True, 5, REAL, 1.0, 4.0),
    "40 kN/m, inertia x 4": Simplification(True, 5, 40e3, 1.0, 4.0),
    "a quarter of the damping": Simplification(True, 5, REAL, 0.25),
    "40 kN/m, a quarter of the damping, inertia x 2": Simplification(True, 5, 40e3, 0.25, 2.0),
    "20 kN/m, a quarter of the damping, inertia x 2": Simplification(True, 5, 20e3, 0.25, 2.0),
    "20 kN/m, an eighth of the damping, inertia x 4": Simplification(True, 5, 20e3, 0.125, 4.0),
}


def measure(
    way: Simplification, robots: Sequence[Walker], seeds: Sequence[int] = SEEDS
) -> tuple[float, FloatArray]:
    """Processor time of all walks [s], and the mean walks of the robots [body lengths per five cycles], shape
    (seeds, robots)."""
    begun = time.process_time()
    walks = np.array([[mean_walk(robot, way, seed) for robot in robots] for seed in seeds])
    return time.process_time() - begun, walks


def main() -> int:
    """Status 0."""
    robots = walkers()
    print("| | processor time | mean difference | root mean square |\n| --- | --- | --- | --- |")
    with limit_threads(1):
        exact_time, exact = measure(WAYS["as they are"], robots)
        for name, way in WAYS.items():
            spent, walks = measure(way, robots)
            off = walks - exact
            error = np.sqrt((off**2).mean())
            print(f"| {name} | {spent / exact_time:.2f} | {off.mean():+.3f} | {error:.3f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
