"""An evolution in the terminal: progress bar, Ctrl-C, the machines that evaluate, the engine's shortcuts."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from eldir.core.arguments import require_value
from eldir.core.provenance import warn_of_other_source
from eldir.errors import EldirError, print_line
from eldir.evolution.printed.run_folder import PrintedRun
from eldir_app.terminal.progress import bar

if TYPE_CHECKING:
    from eldir.evolution.cluster import Cluster
    from eldir.evolution.designs import Run
    from eldir.evolution.run_folder import RunFolder
    from eldir.evolution.search import Search

Show = Callable[[float, str], None]
"""Takes the number of complete generations, with the share of the present one, and a line."""


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
    from eldir.evolution.printed import defaults
    from eldir.evolution.printed.configuration import PrintedEvolutionConfig
    from eldir.lattice import Lattice
    from eldir_hardware.planning.workshop import workshop

    require_new(out)
    given = workshop(rig)
    motors = min(given.motors, defaults.MOTORS) if max_motors is None else max_motors
    remedy = "add channels to the rig file, and give it with --rig"
    require_value(
        "--max-motors", motors <= given.motors, f"at most {given.motors} on this rig", motors, remedy
    )
    config = PrintedEvolutionConfig(
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


def run_evolution(run: Run, cluster: bool, as_json: bool, explain: bool = False, new: bool = False) -> None:
    """Evolve until the end or Ctrl-C, and print the status of the run. The folder of a new run is removed if
    it fails before a result is saved."""
    printed = isinstance(run, PrintedRun)
    boundary = "this generation is complete" if printed else "the robots that are learning are done"
    saved = "the complete generations are saved" if printed else "everything learned so far is saved"
    again = f"continue with eldir evolve --resume {run.path}"
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with run.removed_if_nothing_is_saved() if new else nullcontext(), run.locked():
        warn_of_other_source(run.path, run.source)
        if explain and not isinstance(run, PrintedRun):
            _explain(run.restore())
        with (
            _machines(cluster) as machines,
            bar(*columns, stays=True) as shown,
            _stop_at_boundary(boundary) as stopped,
        ):
            whole = run.whole_generations()
            task = shown.add_task(
                "", total=run.config.generations + 1, completed=whole[-1][0] + 1 if whole else 0
            )

            def show(completed: float, line: str) -> None:
                shown.update(task, completed=completed, description=line)

            try:
                if isinstance(run, PrintedRun):
                    finished = _evolve_printed(run, machines, stopped, show)
                else:
                    finished = _evolve_taught(run, machines, stopped, show)
            except EldirError as error:
                if not run.has_results:
                    raise
                raise EldirError(str(error), remedy=f"{saved}: {again}") from None
    print_status(run, as_json)
    if not finished:
        print_line(f"stopped; {again}")
        raise typer.Exit(130)


def print_status(run: Run, as_json: bool) -> None:
    """Print the status of a run of either kind."""
    from eldir.evolution.printed.status import status_of as status_of_printed
    from eldir.evolution.status import status_of

    status = status_of_printed(run) if isinstance(run, PrintedRun) else status_of(run)
    print(json.dumps(status.to_json(), indent=1) if as_json else f"{status.path}: {status.summary()}")


def _evolve_taught(run: RunFolder, machines: Cluster | None, stopped: Callable[[], bool], show: Show) -> bool:
    """Go on with a run in the paper's scene; returns whether it got to the end."""
    from eldir.evolution.loop import local_trainer, run_generations
    from eldir.evolution.status import progress_line

    search = run.restore()

    def progress(learned: int) -> None:
        fitness = None if search.survivors is None else search.survivors.fitness()
        share = min(learned / run.config.population, 1.0)
        show(search.generation + share, progress_line(search.generation, fitness))

    run_generations(run, search, machines or local_trainer(run), stopped, progress)
    return search.finished


def _evolve_printed(
    run: PrintedRun, machines: Cluster | None, stopped: Callable[[], bool], show: Show
) -> bool:
    """Go on with a run for building; returns whether it got to the end."""
    from eldir.evolution.printed.loop import evolve_printed
    from eldir.evolution.printed.search import PrintedSearch, evaluate_here
    from eldir.evolution.printed.status import progress_line
    from eldir_hardware.planning.workshop import workshop

    def progress(search: PrintedSearch, share: float) -> None:
        show(search.generation + share, progress_line(search.generation, search.archive))

    evaluate = machines.evaluate if machines else evaluate_here
    return evolve_printed(run, workshop().refused, lambda search: stopped(), progress, evaluate)


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
def _machines(cluster: bool) -> Iterator[Cluster | None]:
    """The cluster; None for this machine."""
    if not cluster:
        yield None
        return
    from eldir.evolution.cluster import Cluster

    machines = Cluster()
    try:
        yield machines
    finally:
        machines.close()


@contextmanager
def _stop_at_boundary(what: str) -> Iterator[Callable[[], bool]]:
    """Yields a function that says whether Ctrl-C was pressed or the system asked the process to end: a run
    that goes on for long ends where nothing is lost. The second Ctrl-C interrupts at once. `what` has to be
    done before the run stops."""
    asked = False

    def remember(signum: int, frame: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        print(
            f"the run stops when {what}; press Ctrl-C again to stop at once, without their results",
            file=sys.stderr,
        )

    before = {number: signal.signal(number, remember) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
