"""Timing with little influence of other load: variants run in turns and are compared within a turn."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from eldir.core.records import FloatArray

Way = Callable[[], object]


def take_turns(
    ways: Mapping[str, Way], turns: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, FloatArray]:
    """Seconds of every variant in every turn, shape (turns,), after one warm-up call of each.

    `time.process_time` counts computing but not waiting; use it for one thread.
    """
    for way in ways.values():
        way()
    seconds: dict[str, FloatArray] = {name: np.empty(turns) for name in ways}
    for turn in range(turns):
        for name, way in ways.items():
            began = clock()
            way()
            seconds[name][turn] = clock() - began
    return seconds


def ratio(seconds: Mapping[str, FloatArray], way: str, to: str) -> float:
    """Time of one variant relative to another: the median over turns."""
    return float(np.median(seconds[way] / seconds[to]))


@contextmanager
def limited_threads(n: int) -> Iterator[None]:
    """Limits the engine to `n` threads inside the context."""
    before = os.environ.get("ELDIR_THREADS")
    os.environ["ELDIR_THREADS"] = str(n)
    try:
        yield
    finally:
        if before is None:
            del os.environ["ELDIR_THREADS"]
        else:
            os.environ["ELDIR_THREADS"] = before
