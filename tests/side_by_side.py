"""Checks that only wait, all at the same time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor


def side_by_side(check: Callable[..., object], cases: Sequence[tuple], apart_s: float = 0.0) -> None:
    """Call the check with each case, in a thread of its own, and raise what failed.

    `apart_s`: from the start of one to that of the next [s], where starting takes processor time.
    """

    def check_later(after_s: float, case: tuple) -> None:
        time.sleep(after_s)
        try:
            check(*case)
        except Exception as error:
            error.add_note(f"the case {case}")
            raise

    assert cases
    with ThreadPoolExecutor(len(cases)) as threads:
        calls = [threads.submit(check_later, i * apart_s, case) for i, case in enumerate(cases)]
    failures = [error for call in calls if (error := call.exception())]
    if failures:
        raise BaseExceptionGroup(f"{len(failures)} of {len(cases)} cases failed", failures)
