"""Ctrl-C in a run that goes on for long: the first one ends it where nothing is lost."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def stop_at_boundary(what: str) -> Iterator[Callable[[], bool]]:
    """Yields a function that says whether Ctrl-C was pressed or the system asked the process to end. The
    second Ctrl-C interrupts at once. `what` has to be done before the run stops."""
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
