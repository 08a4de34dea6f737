# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Which commands the relay board has obeyed, so that a report can name the latest one before it."""

from __future__ import annotations

from collections import deque

_MAX_COMMANDS = 100  # a report is younger than a second, a command comes every 0.1 s


class ObeyedCommands:
    """Sequence numbers of commands and when they were obeyed, on the clock of the board's readings [s]."""

    def __init__(self) -> None:
        self._obeyed: deque[tuple[float, str, int]] = deque(maxlen=_MAX_COMMANDS)

    def require_new(self, run: str, sequence: int) -> None:
        """Raise `ValueError` for a command that is repeated or late in its run."""
        _, last_run, last = self._obeyed[-1] if self._obeyed else (0.0, "", 0)
        previous = last if run == last_run else 0
        if sequence <= previous:
            raise ValueError(f"its sequence is {sequence}, expected more than {previous}")

    def add(self, run: str, sequence: int, now: float) -> None:
        """Record a command that was obeyed at `now` [s]."""
        self._obeyed.append((now, run, sequence))

    def before(self, t: float) -> tuple[str, int]:
        """Run and sequence of the last command that was obeyed before `t`; 0 if there is none."""
        earlier = [(run, sequence) for at, run, sequence in self._obeyed if at < t]
        return earlier[-1] if earlier else ("", 0)
