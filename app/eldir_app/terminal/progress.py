"""What a command shows while it works: a bar on a terminal, plain lines in a pipe or a file."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rich.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import ProgressColumn, TaskID

_QUIET = 2.0  # short work says nothing [s]
_STAGE, _LINE = 2.0, 10.0  # least time to the first line of a new stage, and to the next of the same one [s]


def bar(*columns: ProgressColumn, note: str = "", stays: bool = False) -> Progress:
    """A progress bar on stderr, which disappears when the work is done, unless it `stays`. Without a terminal
    it writes a plain line per stage, or every 10 s, as it does where the program log is shown. `note` is said
    first, such as how long this takes."""
    from rich.console import Console

    from eldir.core.program_log import is_detailed

    if note:
        print(note, file=sys.stderr, flush=True)
    screen = Console(stderr=True)
    if screen.is_terminal and not is_detailed():  # lines of other programs would run through it
        return Progress(*columns, console=screen, transient=not stays)
    return _Lines(*columns, console=screen)


def stages(shown: Progress) -> Callable[[str, float], None]:
    """Shows named stages one below the other: takes the name of the present one and its share that is done.
    With a new stage the one before is complete."""
    tasks: dict[str, TaskID] = {}

    def show(stage: str, share: float) -> None:
        if stage not in tasks:
            for before in shown.task_ids[-1:]:
                shown.update(before, completed=1.0)
                shown.stop_task(before)
            tasks[stage] = shown.add_task(stage, total=1.0)
        shown.update(tasks[stage], completed=share)

    return show


class _Lines(Progress):
    """Progress as plain lines, for a pipe or a log file."""

    def __init__(self, *columns: ProgressColumn, console: Console):
        super().__init__(*columns, console=console, disable=True)
        self._begun = time.monotonic()
        self._said = float("-inf")
        self._stage = ""

    def add_task(self, *args: Any, **kwargs: Any) -> TaskID:
        task = super().add_task(*args, **kwargs)
        self._say(task)
        return task

    def update(self, task_id: TaskID, *args: Any, **kwargs: Any) -> None:
        super().update(task_id, *args, **kwargs)
        self._say(task_id)

    def _say(self, task_id: TaskID) -> None:
        task, now = self._tasks[task_id], time.monotonic()
        least = _LINE if task.description == self._stage else _STAGE
        if now - self._begun < _QUIET or now - self._said < least:
            return
        self._said, self._stage = now, task.description
        known = bool(task.total)
        done = f"{task.percentage:.0f} %" if known else f"{task.completed:g} done" if task.completed else ""
        words = ": ".join(part for part in (task.description or "working", done) if part)
        print(f"{words} ({now - self._begun:.0f} s)", file=sys.stderr, flush=True)
