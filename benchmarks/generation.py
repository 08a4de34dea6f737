"""What a generation costs outside the engine's kernel: `python -m benchmarks.generation`.

Robots of the second generation go through everything but the kernel: the weights that they have learned are
those that they began with, and their losses are drawn. Seconds of each part, by the clock and of processor
time.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from eldir.benchmark.other_programs import watch_other_programs
from eldir.controller import Controller
from eldir.engine.pack import pack
from eldir.engine.shortcuts import distinct
from eldir.engine.stable_step import substeps
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.learning import LearningBatch
from eldir.evolution.paper.problem import PaperProblem
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.search import Search
from eldir.physics import resolve_physics
from eldir.training.loop import InitialControllers, make_seed_keys


def measure(robots: int, shard: int) -> dict[str, tuple[float, float]]:
    """Seconds by the clock and of processor time of each part, for so many robots on the paper's lattice."""
    spent: dict[str, tuple[float, float]] = {}

    @contextmanager
    def part(name: str) -> Iterator[None]:
        clock, processor = time.perf_counter(), time.process_time()
        yield
        before = spent.get(name, (0.0, 0.0))
        spent[name] = before[0] + time.perf_counter() - clock, before[1] + time.process_time() - processor

    def pass_by_the_kernel(born: LearningBatch) -> list[Controller]:
        with part("development"):
            bodies = born.bodies
        with part("duplicates and steps"):
            keys, physics = (
                make_seed_keys(len(bodies), born.seeds),
                resolve_physics(bodies, config.scene, None),
            )
            distinct(bodies, keys, physics)
            substeps(bodies, config.scene, physics)
        with part("initial weights and packing"):
            weights = InitialControllers(bodies, config.scene, keys)
            batch = pack(bodies, weights, config.scene, physics)
        with part("unpacking"):
            return batch.controllers(batch.weights)

    config = EvolutionConfig(population=robots)
    search, rng = Search(PaperProblem(config)), np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as scratch:
        run = RunFolder.create(Path(scratch) / "run", config)
        for _ in range(2):
            spent.clear()
            with part("variation"):
                born = search.ask()
                assert isinstance(born, LearningBatch)
            learned: list[Controller] = []
            for first in range(0, robots, shard):
                learned += pass_by_the_kernel(replace(born, robots=born.robots[first : first + shard]))
            losses = -0.01 * rng.random((robots, config.iterations + 1))
            with part("selection"):
                outcome = [
                    replace(robot, losses=own, controller=controller, chaotic_updates=0, rounded_updates=0)
                    for robot, own, controller in zip(born.robots, losses, learned, strict=True)
                ]
                complete = search.tell(born, outcome)
            assert complete is not None
            with part("tables"):
                run.save(complete)
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.generation", description=__doc__)
    parser.add_argument("--robots", type=int, default=10_000, help="population, on the paper's lattice")
    parser.add_argument("--shard", type=int, default=1000, help="robots that are packed together")
    arguments = parser.parse_args()
    with watch_other_programs() as others:
        spent = measure(arguments.robots, arguments.shard)
    spent["all"] = sum(s[0] for s in spent.values()), sum(s[1] for s in spent.values())
    print(f"| {arguments.robots} robots | by the clock [s] | processor [s] |\n| --- | --- | --- |")
    for name, (clock, processor) in spent.items():
        print(f"| {name} | {clock:.2f} | {processor:.2f} |")
    print(f"\n{others.describe()}")


if __name__ == "__main__":
    main()
