"""`python -m benchmarks.coarse_robots`: processor time and error of walks of coarse robots (decision 56).

Robots that walk and their samples are those of `eldir benchmark built`, and of two more seeds. A row is one
way to make them coarse, compared with the robots as they are, five cycles each. The second table compares
those that the product makes on rugged ground, one cycle each.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import numpy as np

from eldir.benchmark.built import REAL, SIMPLIFICATIONS, BenchmarkRobot, Simplification, mean_walk, walkers
from eldir.benchmark.measurement import limit_threads
from eldir.benchmark.other_programs import watch_other_programs
from eldir.core.records import FloatArray
from eldir.defaults import Ground
from eldir.evolution.paper.configuration import make_terrain
from eldir.parameters.printed import BuiltParameters

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
    way: Simplification, robots: Sequence[BenchmarkRobot], seeds: Sequence[int] = SEEDS
) -> tuple[float, FloatArray]:
    """Processor time of all walks [s], and the mean walks of the robots [body lengths per five cycles], shape
    (seeds, robots)."""
    begun = time.process_time()
    walks = np.array([[mean_walk(robot, way, seed) for robot in robots] for seed in seeds])
    return time.process_time() - begun, walks


GROUNDS: dict[Ground, int] = {"level": 1, "incline": 2, "decline": 3}
"""Rugged grounds, and the seed of each."""


def differences_on(ground: Ground, robots: Sequence[BenchmarkRobot]) -> FloatArray:
    """Mean walk of each coarse robot on a rugged ground, less that of the robot as it is [body lengths per
    five cycles]."""
    terrain = make_terrain(ground, GROUNDS[ground]).scaled(BuiltParameters().scale)
    exact, coarse = (
        np.array([mean_walk(robot, SIMPLIFICATIONS[way], terrain=terrain) for robot in robots])
        for way in ("hubs, 1 cycle", "hubs, coarse, 1 cycle")
    )
    return coarse - exact


def main() -> int:
    """Status 0."""
    robots = walkers()
    print("| | processor time | mean difference | root mean square |\n| --- | --- | --- | --- |")
    with limit_threads(1), watch_other_programs() as others:
        exact_time, exact = measure(WAYS["as they are"], robots)
        for name, way in WAYS.items():
            spent, walks = measure(way, robots)
            off = walks - exact
            error = np.sqrt((off**2).mean())
            print(f"| {name} | {spent / exact_time:.2f} | {off.mean():+.3f} | {error:.3f} |", flush=True)
        print("\n| rugged ground | mean difference | root mean square |\n| --- | --- | --- |")
        for ground in GROUNDS:
            found = differences_on(ground, robots)
            print(f"| {ground} | {found.mean():+.2f} | {np.sqrt((found**2).mean()):.2f} |", flush=True)
    print(f"\n{others.describe()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
