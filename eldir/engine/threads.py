"""The number of worker threads, and work on many robots that is divided among threads.

Nothing heavy is imported: what needs no kernel does not start the compiler.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from eldir.core.arguments import require_value

_Result = TypeVar("_Result")
_MIN_ROBOTS = 32  # of one thread: fewer are done before another thread has started
_MAX_THREADS = 8  # for Python's code: more would only wait for the interpreter


def worker_threads() -> int:
    """Worker threads: `ELDIR_THREADS`, or all cores."""
    text = os.environ.get("ELDIR_THREADS", "")
    if not text:
        return os.cpu_count() or 1
    valid = text.isdigit() and int(text) >= 1
    require_value("ELDIR_THREADS", valid, "a whole number, 1 or more", repr(text))
    return int(text)


def for_each(work: Callable[[int], _Result], robots: int) -> list[_Result]:
    """`work(r)` for each robot r, in several threads where there are many robots. This is faster where NumPy
    does most of the work, with thousands of numbers."""
    enough = robots // _MIN_ROBOTS
    threads = min(worker_threads(), _MAX_THREADS, enough) if enough > 1 else 1
    if threads == 1:
        return [work(r) for r in range(robots)]
    ends = [k * robots // threads for k in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        parts = pool.map(lambda first, end: [work(r) for r in range(first, end)], ends, ends[1:])
        return [result for part in parts for result in part]
