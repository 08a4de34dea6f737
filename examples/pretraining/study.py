"""A controller for all bodies, pretrained over random ones, against learning of each robot's own.

    python study.py --out results             # the study; one thread: minutes for each seed
    python study.py --out results --small     # the same within seconds, to see that it runs

Each seed is a file of `--out`, and its controller another one. A call that is repeated goes on with the
seeds that are missing.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from evolution import UniversalProblem, describe, run
from training import SCENE, Trainer, pretrain, random_bodies, save, walks
from universal import UniversalController

import eldir
from eldir.evolution import PaperProblem, Search
from eldir.morphology import develop_all

RATE, FINE_TUNING_RATE = 0.02, 0.005  # of Adam, for each weight


@dataclass(frozen=True)
class Size:
    """How large the study is. Populations are such that all ways take about as long."""

    rows: int = 6
    columns: int = 11
    updates: int = 150
    batch: int = 128
    unseen: int = 200
    own_updates: int = 35
    generations: int = 20
    paper: int = 32
    frozen: int = 512
    tuned: int = 96
    updates_each: int = 5

    @property
    def lattice(self) -> eldir.Lattice:
        return eldir.Lattice(self.rows, self.columns)


SMALL = Size(3, 5, 4, 8, 6, 3, 2, 4, 8, 4, 1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print what is measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--small", action="store_true", help="sizes that show nothing but that it runs")
    given = parser.parse_args(arguments)
    if min(given.seeds) < 0:
        parser.error(f"invalid seed: expected whole numbers from 0, got {min(given.seeds)}")
    if given.out.exists() and not given.out.is_dir():
        parser.error(f"invalid --out: expected a folder, got the file {given.out}")
    given.out.mkdir(parents=True, exist_ok=True)
    size = SMALL if given.small else Size()
    _load_kernels(size)
    for seed in given.seeds:
        file = given.out / f"seed-{seed}.json"
        if not file.exists():
            file.write_text(
                json.dumps({"size": asdict(size), **_study(size, seed, given.out)}, indent=1) + "\n"
            )
        found = json.loads(file.read_text())
        if found["size"] != asdict(size):
            parser.error(f"{file} is of a study of another size: take another folder")
        _print(seed, found)


def _study(size: Size, seed: int, out: Path) -> dict[str, Any]:
    began = time.process_time()
    untrained = UniversalController.random(np.random.default_rng([seed, 0]))
    trainer, rng = Trainer(untrained, RATE), np.random.default_rng([seed, 1])
    curve = pretrain(trainer, size.lattice, size.updates, size.batch, rng)
    seconds = time.process_time() - began
    save(trainer.controller, out / f"controller-{seed}.npz")
    return {
        "pretraining": {"seconds": seconds, "bodies": size.updates * size.batch, "walks": curve},
        "unseen": compare_unseen(size, seed, untrained, trainer.controller),
        "evolution": compare_evolution(size, seed, untrained, trainer.controller),
    }


def compare_unseen(
    size: Size, seed: int, untrained: UniversalController, pretrained: UniversalController
) -> dict[str, Any]:
    """Walks [m] of unseen bodies, the best of the first k updates of their own, from different weights."""
    bodies = random_bodies(size.lattice, size.unseen, np.random.default_rng([seed, 2]))
    ways = {"random": None, "untrained": untrained, "pretrained": pretrained}
    found: dict[str, Any] = {}
    walked = {}
    for way, universal in ways.items():
        began = time.process_time()
        start = None if universal is None else [universal.controller(body) for body in bodies]
        learned = eldir.learn(bodies, SCENE, size.own_updates, seed, start)
        walked[way] = best = np.maximum.accumulate(learned.displacements, axis=1)
        done = np.isfinite(best[:, 0])
        found[way] = {
            "seconds": time.process_time() - began,
            "diverged": int((~done).sum()),
            "mean": best[done].mean(axis=0).tolist(),
            "error": (best[done].std(axis=0, ddof=1) / np.sqrt(done.sum())).tolist(),
        }
    before = walked["pretrained"][:, :1]
    found["share_above"] = (before > walked["random"]).mean(axis=0).tolist()  # after each of their updates
    return found


def compare_evolution(
    size: Size, seed: int, untrained: UniversalController, pretrained: UniversalController
) -> dict[str, Any]:
    """Values of each generation of each way, and what its last bodies walk after updates of their own."""
    paper = eldir.EvolutionConfig(
        size.lattice, size.paper, size.generations, iterations=size.own_updates, seed=seed, scene=SCENE
    )

    def universal(start: UniversalController, population: int, updates: int) -> UniversalProblem:
        trainer = Trainer(start, FINE_TUNING_RATE)
        return UniversalProblem(trainer, size.lattice, population, size.generations, updates, seed)

    problems = {
        "paper": PaperProblem(paper),
        "zero-shot": universal(pretrained, size.frozen, 0),
        "few-shot": universal(pretrained, size.tuned, size.updates_each),
        "from scratch": universal(untrained, size.tuned, size.updates_each),
        "zero-shot, small": universal(pretrained, size.paper, 0),
    }
    return {way: _evolve(size, seed, problem) for way, problem in problems.items()}


def _evolve(size: Size, seed: int, problem: Any) -> dict[str, Any]:
    rows, founder, began = [], dict[int, int](), time.process_time()
    for survivors in run(Search(problem)):
        seconds = time.process_time() - began
        for s in survivors:
            founder.setdefault(s.number, founder.get(s.parents[0], s.number))
        founders = len({founder[s.number] for s in survivors})
        rows.append({"seconds": seconds, "founders": founders, **describe(size.lattice, survivors)})
    # All ways alike: the best bodies of the end, with as many updates of their own as the paper's robots.
    bodies = develop_all(size.lattice, [s.genotype for s in survivors[: size.paper]])
    start = None
    if isinstance(problem, UniversalProblem):
        start = [problem.trainer.controller.controller(body) for body in bodies]
    learned = eldir.learn(bodies, SCENE, size.own_updates, seed + 1000, start).displacements.max(axis=1)
    learned = learned[np.isfinite(learned)]
    return {
        "generations": rows,
        "learned": {"best": float(learned.max()), "mean": float(learned.mean())},
    }


def _load_kernels(size: Size) -> None:
    """So that compiling is not measured."""
    trainer = Trainer(UniversalController.random(np.random.default_rng(0)), 0.0)
    bodies = random_bodies(size.lattice, 2, np.random.default_rng(0))
    trainer.update(bodies)
    walks(trainer.controller, bodies)
    eldir.learn(bodies, SCENE, 1)


def _print(seed: int, found: dict[str, Any]) -> None:
    first = found["pretraining"]
    print(f"seed {seed}: {first['bodies']} bodies in {first['seconds']:.0f} s of processor time")
    for way in ("random", "untrained", "pretrained"):
        mean, error = found["unseen"][way]["mean"], found["unseen"][way]["error"]
        shown = [k for k in (0, 1, 5, len(mean) - 1) if k < len(mean)]
        print(f"  unseen bodies, {way} weights: " + ", ".join(
            f"{mean[k]:.3f} +- {error[k]:.3f} m after {k}" for k in shown) + " own updates")  # fmt: skip
    for way, values in found["evolution"].items():
        begin, end = values["generations"][0], values["generations"][-1]
        print(
            f"  {way}: {end['seconds']:.0f} s, best {begin['best']:.3f} to {end['best']:.3f} m, mean "
            f"{end['mean']:.3f} m, {end['bodies']} bodies that differ in {end['differing_triangles']:.1f} "
            f"triangles (first {begin['differing_triangles']:.1f}); after own updates "
            f"{values['learned']['best']:.3f} m"
        )


if __name__ == "__main__":
    main()
