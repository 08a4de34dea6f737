# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Which commands the relay board has obeyed, so that a report can name the latest one before it."""

from __future__ import annotations

from collections import deque

_MOST = 100  # commands kept; a report is younger than a second, a command comes every 0.1 s


class ObeyedCommands:
    """Numbers of commands and when they were obeyed, on the clock of the board's readings [s]."""

    def __init__(self) -> None:
        self._obeyed: deque[tuple[float, str, int]] = deque(maxlen=_MOST)

    def require_new(self, run: str, number: int) -> None:
        """Raise `ValueError` where a run repeats a command, or sends one that it has overtaken."""
        _, last_run, last = self._obeyed[-1] if self._obeyed else (0.0, "", 0)
        least = last if run == last_run else 0
        if number <= least:
            raise ValueError(f"its number is {number}, expected more than {least}")

    def note(self, run: str, number: int, now: float) -> None:
        """A command was obeyed."""
        self._obeyed.append((now, run, number))

    def before(self, t: float) -> tuple[str, int]:
        """Run and number of the latest command that was obeyed before `t`; 0 where there is none."""
        earlier = [(run, number) for at, run, number in self._obeyed if at < t]
        return earlier[-1] if earlier else ("", 0)
