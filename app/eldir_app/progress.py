"""Progress of a command on stderr: a bar on a terminal, plain lines in a pipe or a file."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rich.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import ProgressColumn, TaskID

_SILENT_S = 2.0  # shorter work prints no line
_STAGE_INTERVAL_S = 2.0  # min. time to the first line of a new stage
_LINE_INTERVAL_S = 10.0  # min. time to the next line of the same stage
_MIN_KNOWN = 0.02  # fraction from which the time left is estimated


def progress_bar(*columns: ProgressColumn, note: str = "", is_permanent: bool = False) -> Progress:
    """A progress bar on stderr, which disappears when the work is done, unless it `is_permanent`. Without a
    terminal, and with -v, it prints a plain line per stage, or every 10 s. `note` is printed first, such as
    how long this takes."""
    from rich.console import Console

    from eldir.core.program_log import is_detailed

    if note:
        print(note, file=sys.stderr, flush=True)
    console = Console(stderr=True)
    if console.is_terminal and not is_detailed():  # lines of other programs would break the bar
        return Progress(*columns, console=console, transient=not is_permanent)
    return _PlainProgress(*columns, console=console)


def show_stages(progress: Progress) -> Callable[[str, float], None]:
    """Show named stages one below the other. The function that is returned takes the name of the present
    stage and its completed fraction; a new stage completes the one before."""
    tasks: dict[str, TaskID] = {}

    def show(stage: str, fraction: float) -> None:
        if stage not in tasks:
            for before in progress.task_ids[-1:]:
                progress.update(before, completed=1.0)
                progress.stop_task(before)
            tasks[stage] = progress.add_task(stage, total=1.0)
        progress.update(tasks[stage], completed=fraction)

    return show


class _PlainProgress(Progress):
    """Progress as plain lines, for a pipe or a log file."""

    def __init__(self, *columns: ProgressColumn, console: Console):
        super().__init__(*columns, console=console, disable=True)
        self._started = time.monotonic()
        self._printed = float("-inf")
        self._stage = ""
        self._begun: dict[TaskID, tuple[float, float]] = {}  # when, and at which completed fraction
        self._steps: set[TaskID] = set()  # tasks of several steps, each from 0 to 100 %

    def add_task(self, *args: Any, **kwargs: Any) -> TaskID:
        task = super().add_task(*args, **kwargs)
        self._begun[task] = time.monotonic(), 0.0
        self._print(task)
        return task

    def update(self, task_id: TaskID, *args: Any, **kwargs: Any) -> None:
        before = self._known(task_id)
        super().update(task_id, *args, **kwargs)
        if self._known(task_id) < before - _MIN_KNOWN:
            self._begun[task_id] = time.monotonic(), self._known(task_id)
            self._steps.add(task_id)
        self._print(task_id)

    def _print(self, task_id: TaskID) -> None:
        task, now = self._tasks[task_id], time.monotonic()
        interval = _LINE_INTERVAL_S if task.description == self._stage else _STAGE_INTERVAL_S
        if now - self._started < _SILENT_S or now - self._printed < interval:
            return
        self._printed, self._stage = now, task.description
        counted = f"{task.completed:g} done" if task.completed else ""
        done = f"{task.percentage:.0f} %" if task.total else counted
        line = ": ".join(part for part in (task.description or "working", done) if part)
        left = self._left(task_id, now)
        print(f"{line} ({now - self._started:.0f} s{left})", file=sys.stderr, flush=True)

    def _left(self, task_id: TaskID, now: float) -> str:
        """How long the task, or its present step, still takes if it goes on as fast as until now; empty where
        that is unknown."""
        begun, first = self._begun[task_id]
        known = self._known(task_id)
        if known - first < _MIN_KNOWN or known >= 1:
            return ""
        what = "left of this step" if task_id in self._steps else "left"
        return f", about {(now - begun) * (1 - known) / (known - first):.0f} s {what}"

    def _known(self, task_id: TaskID) -> float:
        """Completed fraction of a task; 0 where its total is not known."""
        task = self._tasks[task_id]
        return task.completed / task.total if task.total else 0.0
