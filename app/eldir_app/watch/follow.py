"""Follows what is driven: the log of the run that goes on now, or the one log that was named."""

from __future__ import annotations

import asyncio
import json
import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from eldir.errors import EldirError, InputError
from eldir_app.watch.running import Driven, driven_into, driven_ports, driven_through, rig_state
from eldir_app.watch.view import RunView
from eldir_hardware.log.following import LogFollower, LogMessage
from eldir_hardware.rig.board_hints import read_board_hints

_logger = logging.getLogger(__name__)

_POLL = 0.03  # from one look at the file to the next [s]
_LOOK = 0.7  # from one look at the computer to the next [s]
_AT_ONCE = 0.03  # a long log is read in pieces of this time, and stops and pages are served in between [s]
_VIRTUAL = 1e8  # the present is farther from the start than this where the log's time is virtual [s]


class Follow:
    """The newest state of a rig. One task reads, any number of pages ask."""

    def __init__(
        self,
        rig_file: Path | None,
        log: Path | None,
        turned: Callable[[Path], None] = lambda path: None,
    ):
        """`turned`: is told the log whenever another one is followed. Raises `InputError` for a named log
        that is none."""
        self._turned = turned
        self._rig_file, self._named = rig_file, log
        self.view: RunView | None = None
        self.number = 0
        """Counts the runs that were shown."""
        self.state: dict[str, Any] = {}
        self.replay = False
        """Whether the log was finished when it was opened: nothing of it is driven."""
        self._driven: list[Driven] = []
        self._log: LogFollower | None = None
        self._coming: Iterator[LogMessage] = iter(())
        self.trouble: str | None = None
        """Why the log cannot be read on."""
        self._marks: asyncio.subprocess.Process | None = None
        self._readers: set[asyncio.Task[None]] = set()
        self._tell = asyncio.Event()
        if log is not None:
            self._open(log)

    async def stop_words(self) -> list[list[str]]:
        """Words behind each `eldir rig off` that stops what this page is about: the real rig of the file, the
        ports that the rig or the log is driven through, or everything that this computer drives."""
        if self._rig_file is not None and read_board_hints(self._rig_file).ports:
            return [["--rig", str(self._rig_file.resolve())]]
        if self._rig_file is None and self._named is None:
            return [[]]
        driven = self._driven or await asyncio.to_thread(self._look)
        return [["--port", port] for port in dict.fromkeys(d.named or d.port for d in driven)]

    @property
    def driven(self) -> bool:
        """Whether what this page is about is driven now."""
        return bool(self._driven)

    @property
    def players(self) -> set[int]:
        """The programs that drive what is shown and take orders."""
        if self.replay or self._log is None:
            return set()
        log = self._log.path.resolve()
        return {d.player for d in self._driven if log in d.logs and d.takes_orders}

    async def run(self) -> None:
        """Read until cancelled."""
        looking = asyncio.create_task(self._look_again_and_again())
        try:
            while True:
                if self._log is not None and self.trouble is None:
                    self._read()
                await asyncio.sleep(_POLL)
        finally:
            looking.cancel()
            self._end_marks()

    async def changed(self) -> None:
        """Wait for news."""
        await self._tell.wait()

    def picture_at(self, t: float) -> bytes | None:
        """The newest picture that is not later than `t` [s since the start], as JPEG."""
        if self.view is None or self._log is None:
            return None
        before = [p for p in self.view.pictures if p[0] <= t] or self.view.pictures[:1]
        return self._log.read(before[-1][1]).data.tobytes() if before else None

    def _read(self) -> None:
        log, view, until = self._log, self.view, time.monotonic() + _AT_ONCE
        assert log is not None and view is not None
        news = False
        try:
            for followed in self._coming:
                view.take(followed, log)
                news = True
                if time.monotonic() > until:
                    break
            else:
                self._coming = log.poll()
        except (EldirError, OSError) as error:
            self.trouble = str(error)
        if view.read_files(log) or news:
            self._wake()

    def _wake(self) -> None:
        self._tell.set()
        self._tell = asyncio.Event()

    async def _look_again_and_again(self) -> None:
        while True:
            self._driven = await asyncio.to_thread(self._look)
            ports = list(read_board_hints(self._rig_file).ports) if self._rig_file is not None else []
            folder = None if self._log is None else self._log.path.resolve().parent
            state = await asyncio.to_thread(rig_state, self._driven, ports, folder)
            if state != self.state:
                self.state = state
                self._wake()
            self._turn_to_the_newest()
            if self._marks is None and self.view is not None and self.view.pictures:
                await self._begin_marks()
            await asyncio.sleep(_LOOK)

    def _look(self) -> list[Driven]:
        if self._named is not None:
            return [] if self.replay else driven_into(self._named)
        return driven_ports() if self._rig_file is None else driven_through(self._rig_file)

    def _turn_to_the_newest(self) -> None:
        """A run that has begun replaces the one that has ended."""
        if self._named is not None:
            return
        written = [log for d in self._driven for log in d.logs]
        if written and (self._log is None or self._log.path.resolve() not in written):
            with suppress(InputError, OSError):  # it has ended since
                self._open(max(written, key=lambda log: log.stat().st_mtime))

    def _open(self, path: Path) -> None:
        log = LogFollower(path)
        log.open()
        _logger.info("following %s", path)
        self._end_marks()
        if self._log is not None:
            self._log.close()
        self._log, self.view, self._coming, self.trouble = log, RunView(log.path), log.poll(), None
        self.replay = self._named is not None and log.is_whole
        self.number += 1
        if not self.replay:
            self._turned(log.path.resolve())

    async def _begin_marks(self) -> None:
        assert self._log is not None and self.view is not None
        self._marks = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "eldir_app.watch.marks",
            str(self._log.path.resolve()),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
        )
        reader = asyncio.create_task(self._take_marks(self._marks, self.view))
        self._readers.add(reader)
        reader.add_done_callback(self._readers.discard)

    async def _take_marks(self, process: asyncio.subprocess.Process, view: RunView) -> None:
        assert process.stdout is not None
        while line := await process.stdout.readline():
            with suppress(ValueError):
                row = json.loads(line)
                if isinstance(row, list):
                    view.curves["marks"].add(row)
                else:
                    view.curves["events"].add([view.latest, 0, "marks", row])
                self._wake()
        await process.wait()

    def _end_marks(self) -> None:
        if self._marks is not None and self._marks.returncode is None:
            with suppress(ProcessLookupError):
                self._marks.kill()
        self._marks = None

    @property
    def now(self) -> float | None:
        """Time of the run [s since the start]; None for a replay, in virtual time and before the start."""
        epoch = None if self._log is None else self._log.epoch_ns
        if epoch is None or self.replay:
            return None
        now = (time.time_ns() - epoch) * 1e-9
        return round(now, 3) if abs(now) < _VIRTUAL else None

    @property
    def ended(self) -> bool:
        """Whether the run that is shown has ended."""
        return self._log is None or self._log.ended
