"""`python -m benchmarks.mass_scaling`: what more inertia changes in a walk (decision 42), as a table.

Robots that walk, with the samples of `eldir benchmark built`. A row is one way to simulate them; each of its
columns is compared with the same way and the masses as they are.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from eldir.benchmark.built import REAL, Simplification, Walker, mean_walk, walkers

FACTORS = (2.0, 4.0, 9.0, 16.0)
ROWS = {
    "hubs, five cycles": Simplification(True, REAL, 5),
    "hubs, one cycle": Simplification(True, REAL, 1),
    "hubs, strips of 40 kN/m, one cycle": Simplification(True, 40e3, 1),
    "pins, real strips, one cycle": Simplification(False, REAL, 1),
    "pins, strips of 20 kN/m, one cycle": Simplification(False, 20e3, 1),
}


def differences(
    way: Simplification, factors: Sequence[float] = FACTORS, robots: Sequence[Walker] | None = None
) -> list[float]:
    """Root mean square over the robots of the change of the mean walk by each factor on the inertia
    [body lengths per five cycles]."""
    chosen = walkers() if robots is None else robots
    walks = [
        np.array([mean_walk(robot, way._replace(mass_scaling=factor)) for robot in chosen])
        for factor in (1.0, *factors)
    ]
    return [float(np.sqrt(((each - walks[0]) ** 2).mean())) for each in walks[1:]]


def main() -> int:
    """Status 0."""
    print("| | " + " | ".join(f"factor {factor:g}" for factor in FACTORS) + " |")
    print("| --- |" + " --- |" * len(FACTORS))
    for name, way in ROWS.items():
        print(f"| {name} | " + " | ".join(f"{each:.2f}" for each in differences(way)) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
