"""A run with a cheap stand-in for learning, in a process of its own that tests may kill."""

import sys
import time
from pathlib import Path

import pyarrow.parquet  # noqa: F401  before the clock of the killer starts

from eldir.evolution.loop import run_generations
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.run_folder import RunFolder
from eldir.lattice import Lattice
from tests.eldir.evolution.pretended_searches import learn

CONFIG = EvolutionConfig(Lattice(4, 6), population=12, generations=12, max_active=2, iterations=3, seed=5)


class Pretence:
    """A teacher that takes a few milliseconds a shard."""

    def part_size(self, batch, tasks):
        return 5

    def __call__(self, shards):
        for shard in shards:
            time.sleep(0.004)
            yield shard, learn(shard, CONFIG)


def run(folder: Path) -> None:
    found = RunFolder.open(folder) if folder.exists() else RunFolder.create(folder, CONFIG)
    print("begins", flush=True)
    with found.locked():
        run_generations(found, found.restore(), Pretence())


if __name__ == "__main__":
    run(Path(sys.argv[1]))
