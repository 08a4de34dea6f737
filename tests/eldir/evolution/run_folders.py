"""A run folder that goes on with a pretended evaluation, and its bytes."""

from pathlib import Path

from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.search import Search
from tests.eldir.evolution.pretended_searches import complete_generation


def go_on(run: RunFolder, search: Search, generations: int = 99) -> Search:
    for _ in range(generations):
        if search.finished:
            break
        run.save(complete_generation(search))
    return search


def contents(path: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(path.iterdir())}
