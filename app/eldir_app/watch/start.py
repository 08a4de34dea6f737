"""Starts the one schedule that `--allow-start` names: `eldir rig drive` in a process of its own.

Its output goes to a file, and nothing of it depends on the server: a run goes on when the page's server dies.
"""

from __future__ import annotations

import subprocess
import sys
from datetime import datetime
from pathlib import Path

from eldir.errors import InputError
from eldir_hardware.rig.board_hints import read_board_hints
from eldir_hardware.safety.latch import latched, stop_of
from eldir_hardware.schedule import ActuationSchedule

_SAID = 400  # of the last lines of a run that failed [characters]


class Start:
    """What may be started, and what became of it."""

    def __init__(self, rig: Path, schedule: Path):
        """Raises `InputError` for what is no schedule."""
        ActuationSchedule.load(schedule)
        self.rig, self.schedule = rig.resolve(), schedule.resolve()
        self._running: subprocess.Popen[bytes] | None = None
        self._output = Path()

    def start(self, driven: bool) -> None:
        """Start the schedule, and return at once. Raises `EldirError` where the rig is `driven` already or a
        stop is latched; the guardian, which alone closes contacts, checks both again."""
        if driven or self.is_running:
            raise InputError("something is driven already", remedy="wait for its end")
        for port in read_board_hints(self.rig).ports:
            if (why := stop_of(port)) is not None:
                raise latched(port, why)
        now = datetime.now().strftime("%Y-%m-%d-%H%M%S")
        log = self.schedule.with_name(f"{self.schedule.stem}-{now}.mcap")
        self._output = log.with_suffix(".txt")
        words = [str(self.schedule), "--rig", str(self.rig), "--log", str(log)]
        with self._output.open("xb") as output:
            self._running = subprocess.Popen(
                [sys.executable, "-m", "eldir", "rig", "drive", *words],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C ends the server, not the run
            )

    @property
    def is_running(self) -> bool:
        """Whether what was started has not ended."""
        return self._running is not None and self._running.poll() is None

    @property
    def failure(self) -> str | None:
        """What the run that was started last said when it failed."""
        if self._running is None or not self._running.poll():
            return None
        lines = self._output.read_text(errors="replace").strip().splitlines()
        return "\n".join(line for line in lines if line.startswith("eldir:"))[-_SAID:] or "it did not say why"
