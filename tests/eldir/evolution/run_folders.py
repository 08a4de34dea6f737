"""A run folder that goes on with a pretended evaluation, and its bytes."""

from pathlib import Path

from eldir.evolution.run_folder import RunFolder
from eldir.evolution.search import Search
from tests.eldir.evolution.pretended_searches import evaluate


def go_on(run: RunFolder, search: Search, generations: int = 99) -> Search:
    for _ in range(generations):
        if search.finished:
            break
        robots = search.ask()
        run.save(search, search.tell(robots, evaluate(robots, run.config)))
    return search


def contents(path: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(path.iterdir())}
