"""`python -m benchmarks.encodings --out FOLDER`: encodings of bodies at equal processor time (decision 76).

For each seed the direct encoding evolves for all generations, and the networks for as much processor time as
it took. The table has the last generation that each has completed by then: fitness, how much bodies differ,
and their size. A call that was interrupted goes on with the generations that are missing.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eldir.benchmark.other_programs import watch_other_programs
from eldir.core.files import write_text
from eldir.defaults import MAX_GENERATIONS, Crossover, EncodingName
from eldir.evolution.loop import run_generations
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.population import Robot
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.workers import LocalWorkers
from eldir.lattice import Lattice
from eldir.learning import learn
from eldir.morphology import develop_all

WAYS: tuple[tuple[EncodingName, Crossover], ...] = (("direct", "none"), ("cppn", "none"), ("cppn", "neat"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table, and keep run folders and the values of every generation in `--out`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.encodings", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder, new or of an interrupted call")
    parser.add_argument("--lattice", type=int, nargs=2, default=[13, 22], metavar=("ROWS", "COLUMNS"))
    parser.add_argument("--population", type=int, default=512)
    parser.add_argument("--generations", type=int, default=50, help="of the direct encoding")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    size = (given.population, given.generations)
    print("| seed | encoding, crossover | processor time | generations | best | mean | bodies differ in "
          "| different bodies | springs | motors |")  # fmt: skip
    print("| --- " * 10 + "|")
    with watch_other_programs() as others:
        for seed in given.seeds:
            budget = np.inf
            for way in WAYS:
                config = _config(way, Lattice(*given.lattice), *size, seed)
                rows = _evolve(given.out / f"{'-'.join(way)}-{seed}", config, budget)
                inside = [row for row in rows if row["seconds"] <= budget]
                print(_describe(seed, way, len(inside) - 1, inside[-1]), flush=True)
                if way == WAYS[0]:
                    budget = rows[-1]["seconds"]
    print(f"\n{others.describe()}")


def _config(
    way: tuple[EncodingName, Crossover], lattice: Lattice, population: int, generations: int, seed: int
) -> EvolutionConfig:
    """Networks may have any number of generations: their time ends them."""
    encoding, crossover = way
    last = generations if way == WAYS[0] else MAX_GENERATIONS
    return EvolutionConfig(lattice, population, last, encoding=encoding, crossover=crossover, seed=seed)


def _evolve(folder: Path, config: EvolutionConfig, budget: float) -> list[dict[str, Any]]:
    """Values of each generation. A run that was interrupted goes on after its last complete generation."""
    file = folder.with_suffix(".jsonl")
    run, found = _open(folder, config, file)
    search = run.restore()
    if search.finished or (found and found[-1]["seconds"] >= budget):
        return found
    _load_kernels(search.ask().bodies[:1], config)  # type: ignore[attr-defined]
    began = time.process_time() - (found[-1]["seconds"] if found else 0.0)

    def note(share: float) -> None:
        if search.generation > len(found):
            spent = time.process_time() - began
            found.append({"seconds": spent} | _values(config.lattice, search.archive.ranked()))
            with file.open("a") as rows:
                rows.write(json.dumps(found[-1]) + "\n")

    run_generations(run, search, LocalWorkers(), lambda: bool(found) and found[-1]["seconds"] >= budget, note)
    return found


def _open(folder: Path, config: EvolutionConfig, file: Path) -> tuple[RunFolder, list[dict[str, Any]]]:
    """The run folder, and the values of its complete generations. Robots of a generation that was interrupted
    are evaluated again, because the time that they took is not known."""
    if file.exists():
        run = RunFolder.open(folder)
        complete = run.restore().generation
        lines = file.read_text().splitlines()[:complete]
        if run.config == config and len(lines) == complete:
            for part in run.parts(complete):
                part.unlink()
            write_text(file, "".join(line + "\n" for line in lines))
            return run, [json.loads(line) for line in lines]
    shutil.rmtree(folder, ignore_errors=True)
    write_text(file, "")
    return RunFolder.create(folder, config), []


def _load_kernels(bodies: Sequence[Any], config: EvolutionConfig) -> None:
    learn(bodies, config.scene, 1, [0], training=config.training)


def _values(lattice: Lattice, robots: Sequence[Robot]) -> dict[str, Any]:
    bodies = develop_all(lattice, [r.genotype for r in robots])
    masks = np.stack([r.genotype.triangles.ravel() for r in robots]).astype(np.float64)
    filled = masks.mean(axis=0)  # the mean distance of two masks of a population, drawn with replacement
    return {
        "best": robots[0].fitness,
        "mean": float(np.mean([r.fitness for r in robots])),
        "distance": float((2 * filled * (1 - filled)).mean()),
        "bodies": len({body.body_key for body in bodies}),
        "springs": float(np.mean([len(body.springs) for body in bodies])),
        "motors": float(np.mean([body.active.mean() for body in bodies])),
    }


def _describe(seed: int, way: tuple[str, str], generation: int, row: dict[str, Any]) -> str:
    return (
        f"| {seed} | {way[0]}, {way[1]} | {row['seconds']:.0f} s | {generation} | {row['best']:.3f} m "
        f"| {row['mean']:.3f} m | {100 * row['distance']:.1f} % of triangles | {row['bodies']} "
        f"| {row['springs']:.0f} | {row['motors']:.2f} |"
    )


if __name__ == "__main__":
    main()
