"""An evolution for building in the terminal: progress bar, Ctrl-C and status."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from eldir.commands.stopping import stop_at_boundary
from eldir.core.new_run import removed_if_nothing_is_saved
from eldir.evolution.printed.run_folder import PrintedRun

if TYPE_CHECKING:
    from eldir.evolution.printed.search import Judge


def new_printed_run(
    out: Path,
    rig: Path | None,
    lattice: tuple[int, int] | None,
    population: int | None,
    generations: int | None,
    max_motors: int | None,
    static_margin: float | None,
    seed: int,
) -> PrintedRun:
    """A new run folder; None takes the default. Raises `EldirError` for more motors than the rig heats."""
    from eldir.core.files import require_new
    from eldir.errors import InputError
    from eldir.evolution.printed import defaults
    from eldir.evolution.printed.configuration import PrintedEvolution
    from eldir.evolution.printed.workshop import installed_workshop
    from eldir.lattice import Lattice

    require_new(out)
    given = installed_workshop(rig)
    motors = min(given.motors, defaults.MOTORS) if max_motors is None else max_motors
    if motors > given.motors:
        raise InputError(
            "the rig cannot heat so many motors",
            expected=f"at most {given.motors}",
            found=str(motors),
            remedy="add channels to the rig file, and give it with --rig",
        )
    config = PrintedEvolution(
        lattice=Lattice(*(lattice or defaults.LATTICE)),
        offspring=defaults.OFFSPRING if population is None else population,
        generations=defaults.GENERATIONS if generations is None else generations,
        max_active=motors,
        static_margin=defaults.MARGIN if static_margin is None else static_margin,
        seed=seed,
        printed=given.printed,
        springs=given.springs,
        timings=given.timings,
    )
    return PrintedRun.create(out, config)


def run_printed(run: PrintedRun, cluster: bool, as_json: bool, new: bool = False) -> None:
    """Evolve until the end or Ctrl-C, and print the status of the run. The folder of a new run is removed if
    it fails in its first generation."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

    from eldir.commands.progress import bar
    from eldir.core.provenance import warn_of_other_source
    from eldir.errors import print_line
    from eldir.evolution.printed.loop import evolve_printed
    from eldir.evolution.printed.status import progress_line, status_of
    from eldir.evolution.printed.workshop import installed_workshop

    warn_of_other_source(run.path, run.source)
    refused = installed_workshop().refused
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with (
        removed_if_nothing_is_saved(run.path) if new else nullcontext(),
        run.locked(),
        bar(*columns, stays=True) as shown,
        _judge(cluster) as judge,
        stop_at_boundary("this generation is complete") as stopped,
    ):
        task = shown.add_task("", total=run.config.generations + 1)
        finished = evolve_printed(
            run,
            refused,
            lambda search: stopped(),
            lambda search, share: shown.update(
                task,
                completed=search.generation + share,
                description=progress_line(search.generation, search.archive),
            ),
            judge,
        )
    status = status_of(run)
    print(json.dumps(status.to_json(), indent=1) if as_json else f"{run.path}: {status.summary()}")
    if not finished:
        print_line(f"stopped; continue with eldir evolve --resume {run.path}")
        raise typer.Exit(130)


@contextmanager
def _judge(cluster: bool) -> Iterator[Judge]:
    if not cluster:
        from eldir.evolution.printed.search import judged_here

        yield judged_here
        return
    from eldir.evolution.cluster import Cluster

    machines = Cluster()
    try:
        yield machines.judge
    finally:
        machines.close()
