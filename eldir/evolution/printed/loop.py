"""Evolving a run of printed robots: one generation after the other, each saved when it is complete."""

from __future__ import annotations

from collections.abc import Callable

from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.printed.search import Evaluator, PrintedSearch, Refused, evaluate_here


def evolve_printed(
    run: PrintedRun,
    refused: Refused = lambda body: "",
    stopped: Callable[[PrintedSearch], bool] = lambda search: False,
    progress: Callable[[PrintedSearch, float], None] = lambda search, share: None,
    evaluate: Evaluator = evaluate_here,
) -> bool:
    """Continue a run to its end; returns whether it got there.

    `refused` says why a body cannot be built, and must be the same whenever a run is continued. `stopped` is
    asked before each generation; `progress` is called with the search and the present generation's share.
    `evaluate` runs the trials, such as `Cluster.evaluate`. The caller holds the run's lock
    if several processes may write.
    """
    search = run.restore(refused)
    search.evaluate = evaluate
    while not search.finished:
        if stopped(search):
            return False
        generation = search.step(lambda share: progress(search, min(share, 0.99)))
        run.save(generation, search.archive)
        progress(search, 0.0)
    return True
