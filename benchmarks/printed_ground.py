"""`python -m benchmarks.printed_ground`: what a terrain costs printed robots, the table of
docs/reference/built.md."""

from __future__ import annotations

import sys
import time

import numpy as np

from eldir.benchmark.measurement import limit_threads, time_in_turns
from eldir.benchmark.other_programs import watch_other_programs
from eldir.built.motion import FREE, drive
from eldir.built.robot import PrintedRobot, build
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.parameters.printed import BuiltParameters
from eldir.terrain import Terrain

KINDS = {
    "pins": BuiltParameters(),
    "clamped strips": BuiltParameters.clamped(),
    "hubs": BuiltParameters().with_hubs(),
}
_ROBOTS, _SECONDS, _INTERVAL = 8, 4.0, 0.02
_PERIOD = 20.0  # of the motors [s]


def seconds(robot: PrintedRobot, turns: int = 5) -> tuple[float, float]:
    """Processor time of eight equal robots on a table and on rugged ground [s], least of all turns."""
    rugged = Terrain.rugged(np.random.default_rng(0)).scaled(robot.parameters.scale)
    t = np.arange(round(_SECONDS / _INTERVAL) + 1)[:, None] * _INTERVAL
    turned = t / _PERIOD - 0.25 * np.arange(int(robot.active.sum()))
    cold, hot = FREE
    lengths = cold + (hot - cold) * (1 - np.cos(2 * np.pi * np.maximum(turned, 0.0))) / 2
    ways = {
        name: lambda ground=ground: drive(
            [robot] * _ROBOTS, [lengths] * _ROBOTS, _INTERVAL, every=len(lengths) - 1, terrain=ground
        )
        for name, ground in (("table", None), ("rugged", rugged))
    }
    found = time_in_turns(ways, turns, time.process_time)
    return float(found["table"].min()), float(found["rugged"].min())


def main() -> int:
    """Status 0."""
    lattice = Lattice(6, 11)
    body = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(7), max_active=2)[0])
    print(f"{_ROBOTS} robots of {len(body.positions)} masses and {len(body.springs)} springs, {_SECONDS:g} s")
    print("| | level table [s] | rugged ground [s] | ratio |\n| --- | --- | --- | --- |")
    with limit_threads(1), watch_other_programs() as others:
        for name, parameters in KINDS.items():
            table, rugged = seconds(build(body, parameters))
            print(f"| {name} | {table:.3f} | {rugged:.3f} | {rugged / table:.2f} |", flush=True)
    print(f"\n{others.describe()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
