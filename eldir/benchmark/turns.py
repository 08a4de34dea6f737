"""Timing that other work on the machine disturbs least: ways take turns, and turns are compared."""

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
    """Seconds of every way in every turn, shape (turns,), after one call of each that does not count.

    With `time.process_time` a way is charged what it computes and not what it waits for; for one thread.
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
    """How long one way takes in terms of another: the median over turns."""
    return float(np.median(seconds[way] / seconds[to]))


@contextmanager
def limited_threads(n: int) -> Iterator[None]:
    """The engine with so many threads."""
    before = os.environ.get("ELDIR_THREADS")
    os.environ["ELDIR_THREADS"] = str(n)
    try:
        yield
    finally:
        if before is None:
            del os.environ["ELDIR_THREADS"]
        else:
            os.environ["ELDIR_THREADS"] = before
