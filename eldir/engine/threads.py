"""Threads: how many there are, and work on many robots that is divided among them.

Nothing heavy is imported: what needs no kernel does not start the compiler.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from eldir.core.arguments import require_value

_Result = TypeVar("_Result")
_ROBOTS = 32  # of one thread: fewer are done before another thread has started
_MOST = 8  # threads for Python's code: more would only wait for the interpreter


def worker_threads() -> int:
    """Worker threads: `ELDIR_THREADS`, or all cores."""
    text = os.environ.get("ELDIR_THREADS", "")
    if not text:
        return os.cpu_count() or 1
    good = text.isdigit() and int(text) >= 1
    require_value("ELDIR_THREADS", good, "a whole number, 1 or more", repr(text))
    return int(text)


def for_each(work: Callable[[int], _Result], robots: int) -> list[_Result]:
    """`work(r)` for each robot r, in several threads where there are many robots. It gains where the work is
    mostly NumPy's with thousands of numbers."""
    enough = robots // _ROBOTS
    threads = min(worker_threads(), _MOST, enough) if enough > 1 else 1
    if threads == 1:
        return [work(r) for r in range(robots)]
    ends = [k * robots // threads for k in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        parts = pool.map(lambda first, end: [work(r) for r in range(first, end)], ends, ends[1:])
        return [result for part in parts for result in part]
