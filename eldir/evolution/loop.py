"""Evolving a run: batches are evaluated in parts, long parts are saved when they are done, and then the
search selects.

The result of a task depends on the task alone. The order, the machine and interruptions make no difference.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from eldir.evolution.designs import Run, RunConfiguration, create_run, open_run
from eldir.evolution.problem import Batch
from eldir.evolution.run_folder import GenerationsFolder
from eldir.evolution.search import Search
from eldir.evolution.workers import Workers


def evolve(
    config: RunConfiguration, folder: Path | str, progress: Callable[[int, float], None] | None = None
) -> Run:
    """Evolve into a new run folder, on this machine, to the last generation.

    `progress` is called after every generation with its number and the best fitness: [m] in the paper's
    scene. The same configuration gives the same bytes. Raises `EldirError` where the folder exists already,
    or where no robot of the first generation is stable. An interrupted run goes on with `resume`; one that
    fails before a robot has learned leaves no folder.

        from eldir.evolution import EvolutionConfig, evolve, load_run

        run = evolve(EvolutionConfig(Lattice(6, 11), population=16, generations=3, max_active=2), "run")
        best = load_run(run.path)[0]
    """
    run = create_run(Path(folder), config)
    with run.remove_if_empty():
        return _run_to_end(run, progress)


def resume(folder: Path | str, progress: Callable[[int, float], None] | None = None) -> Run:
    """Go on with an interrupted run to its last generation; it ends with the same bytes as one that was not
    interrupted. `progress` as in `evolve`."""
    return _run_to_end(open_run(Path(folder)), progress)


def _run_to_end(run: Run, progress: Callable[[int, float], None] | None) -> Run:
    with run.locked():
        search = run.restore()
        reported = search.generation

        def saved(share: float) -> None:
            nonlocal reported
            if progress is not None and search.generation > reported and len(search.archive):
                reported = search.generation
                progress(reported - 1, search.archive.ranked()[0].fitness)

        run_generations(run, search, run.workers(), progress=saved)
    return run


def run_generations(
    run: GenerationsFolder[Any, Any],
    search: Search[Any],
    workers: Workers,
    stopped: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] = lambda share: None,
) -> None:
    """Go on until the last generation is saved, or `stopped` returns true: it is asked before each
    generation, and after each part that is saved. `progress` is called with the fraction of the present
    generation that is done, and with 0 when the search has selected. A generation is saved while the next one
    is evaluated. The caller holds the run's lock."""
    with ThreadPoolExecutor(1) as background:
        saved: Future[None] | None = None
        while not (search.finished or stopped()):
            generation, done = None, 0.0

            def report(share: float) -> None:
                nonlocal done
                done = max(done, share)  # solutions that are evaluated again do not set it back
                progress(done)

            while generation is None:
                batch = search.ask()
                outcome = _evaluate(run, batch, workers, stopped, report)
                if saved is not None:
                    saved.result()
                if outcome is None:
                    return
                generation = search.tell(batch, outcome)
            # While the next robots learn: the weights of ten thousand take seconds to write.
            saved = background.submit(run.save, generation)
            progress(0.0)
        if saved is not None:
            saved.result()


def _evaluate(
    run: GenerationsFolder[Any, Any],
    batch: Batch,
    workers: Workers,
    stopped: Callable[[], bool],
    progress: Callable[[float], None],
) -> Any:
    """The outcome of a batch, or None if it was stopped before the last part."""
    found = run.read_parts(batch)
    known = np.zeros(len(batch), bool)
    first, last = batch.span
    for index, _ in found:
        known[index] = True
    progress(first + (last - first) * known.mean())
    missing = np.flatnonzero(~known)
    for part, result in workers(batch.parts(missing, workers.part_size(batch, len(missing)))):
        found.append((part.index, result))
        known[part.index] = True
        is_last = bool(known.all())
        if batch.has_long_tasks and not is_last:  # the last part is saved with its generation
            run.save_part(result)
        progress(first + (last - first) * known.mean())
        if batch.has_long_tasks and not is_last and stopped():
            return None
    return batch.join(found)
