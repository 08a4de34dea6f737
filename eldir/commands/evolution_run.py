"""An evolution in the terminal: progress bar, Ctrl-C, the machines that teach, and the engine's shortcuts."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

import typer

from eldir.commands.stopping import stop_at_boundary

if TYPE_CHECKING:
    from eldir.evolution.loop import Teacher
    from eldir.evolution.run_folder import RunFolder
    from eldir.evolution.search import Evolution, Search


def run_evolution(run: RunFolder, cluster: bool, as_json: bool, explain: bool, new: bool = False) -> None:
    """Evolve until the end or Ctrl-C, and print the status of the run. The folder of a new run is removed if
    it fails before a robot has learned."""
    from eldir.core.new_run import has_results, removed_if_nothing_is_saved
    from eldir.core.provenance import warn_of_other_source
    from eldir.errors import EldirError, print_line
    from eldir.evolution.loop import run_generations
    from eldir.evolution.status import status_of

    again = f"continue with eldir evolve --resume {run.path}"
    with removed_if_nothing_is_saved(run.path) if new else nullcontext(), run.locked():
        warn_of_other_source(run.path, run.source)
        search = run.restore()
        if explain:
            _explain(search)
        with (
            _teacher(cluster) as teacher,
            _progress(run.config, search) as progress,
            stop_at_boundary("the robots that are learning are done") as stopped,
        ):
            try:
                run_generations(run, search, teacher, stopped, progress)
            except EldirError as error:
                if not has_results(run.path):
                    raise
                raise EldirError(str(error), remedy=f"everything learned so far is saved: {again}") from None
    status = status_of(run)
    print(json.dumps(status.to_json(), indent=1) if as_json else f"{run.path}: {status.summary()}")
    if not search.finished:
        print_line(f"stopped; {again}")
        raise typer.Exit(130)


def _explain(search: Search) -> None:
    from eldir.engine.shortcuts import Skip, explain_skips

    config = search.config
    bodies = search.ask().morphologies(config.lattice)
    skips = explain_skips(bodies, config.scene, backward=True, record=False)
    survivors = 0 if search.survivors is None else len(search.survivors.losses)
    skips.append(
        Skip("learning of survivors", f"{survivors} so far keep the results of their first generation")
    )
    for skip in skips:
        print(f"left out: {skip.what}: {skip.why}", file=sys.stderr)


@contextmanager
def _teacher(cluster: bool) -> Iterator[Teacher]:
    if not cluster:
        from eldir.evolution.loop import LocalTeacher

        yield LocalTeacher()
        return
    from eldir.evolution.cluster import Cluster

    many = Cluster()
    try:
        yield many
    finally:
        many.close()


@contextmanager
def _progress(config: Evolution, search: Search) -> Iterator[Callable[[int], None]]:
    """A bar on stderr. The function it yields takes the number of robots of this generation that have
    learned."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

    from eldir.commands.progress import bar
    from eldir.evolution.status import progress_line

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with bar(*columns, stays=True) as shown:
        task = shown.add_task("", total=config.generations + 1, completed=search.generation)

        def update(learned: int) -> None:
            share = min(learned / config.population, 1.0)
            fitness = None if search.survivors is None else search.survivors.fitness()
            line = progress_line(search.generation, fitness)
            shown.update(task, completed=search.generation + share, description=line)

        yield update
