"""The run that the page shows: the one that is being recorded now, or the log that was given."""

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
from eldir_app.watch.driven_rigs import (
    DrivenPort,
    driven_ports,
    ports_of_log,
    ports_of_rig,
    rig_state,
)
from eldir_app.watch.run_view import RunView
from eldir_hardware.log.following import LogFollower, LogMessage
from eldir_hardware.rig._board_hints import read_board_hints
from eldir_hardware.run.virtual_runs import VirtualRun, list_virtual_runs, virtual_runs_of

_logger = logging.getLogger(__name__)

_LOG_INTERVAL_S = 0.03  # between two reads of the log
_PROCESS_INTERVAL_S = 0.7  # between two searches for driven ports
_READ_TIME_S = 0.03  # a long log is read in pieces of this time; stops and pages are served in between
_MAX_LINE = 1 << 20  # of the tracking process: a ground has up to thousands of corners
FILES_OF_A_WALK = frozenset({"design.json", "schedule.json", "rig.yaml"})
"""Attached files from which the walk is predicted."""
_MAX_RUN_TIME_S = 1e8  # a log that started longer ago than this has virtual time


class FollowedRun:
    """Follows the newest run of a rig, or one log. One task reads it for any number of pages."""

    def __init__(
        self,
        rig_file: Path | None,
        log: Path | None,
        on_log: Callable[[Path], None] = lambda path: None,
    ):
        """`on_log` is called with each log that is followed. Raises `InputError` if `log` is not a log."""
        self._on_log = on_log
        self._rig_file, self._given_log = rig_file, log
        self.view: RunView | None = None
        self.number = 0
        """Number of runs that were followed."""
        self.rig_state: dict[str, Any] = {}
        """Guardian, player, latch and disk, as the page shows them."""
        self.is_replay = False
        """Whether the log was finished when it was opened: no rig is driven for it."""
        self.is_behind = False
        """Whether more of the log is there than was read."""
        self._driven: list[DrivenPort] = []
        self._virtual: list[VirtualRun] = []
        self._log: LogFollower | None = None
        self._messages: Iterator[LogMessage] = iter(())
        self.problem: str | None = None
        """Why the rest of the log cannot be read."""
        self._tracking: asyncio.subprocess.Process | None = None
        self._predicting: asyncio.subprocess.Process | None = None
        self._readers: set[asyncio.Task[None]] = set()
        self._changed = asyncio.Event()
        if log is not None:
            self._open(log)

    async def stop_arguments(self) -> list[list[str]]:
        """Arguments of each `eldir rig off` that is needed for a stop: of the rig file, of the ports that
        drive the log, or of everything that this computer drives."""
        if self._rig_file is not None and read_board_hints(self._rig_file).ports:
            return [["--rig", str(self._rig_file.resolve())]]
        if self._rig_file is None and self._given_log is None:
            is_virtual_only = self._virtual and not await asyncio.to_thread(self._find_driven)
            return [] if is_virtual_only else [[]]
        driven = self._driven or await asyncio.to_thread(self._find_driven)
        if self._rig_file is not None:  # a virtual rig, whose port is another one in each run
            return [["--rig", str(self._rig_file.resolve())]] if driven else []
        return [["--port", port] for port in dict.fromkeys(d.given_name or d.port for d in driven)]

    async def virtual_runs(self) -> list[VirtualRun]:
        """The runs in virtual time that a stop ends: they have no port."""
        return await asyncio.to_thread(self._find_virtual)

    @property
    def is_driven(self) -> bool:
        """Whether the rig of this page is being driven."""
        return bool(self._driven or self._virtual)

    @property
    def players(self) -> set[int]:
        """Process numbers of the players of this run that accept orders."""
        if self.is_replay or self._log is None:
            return set()
        log = self._log.path.resolve()
        players = {d.player for d in self._driven if log in d.logs and d.accepts_commands}
        return players | {run.player for run in self._virtual if run.log == log}

    async def run(self) -> None:
        """Read until cancelled."""
        watching = asyncio.create_task(self._watch_processes())
        try:
            while True:
                if self._log is not None and self.problem is None:
                    self._read()
                await asyncio.sleep(_LOG_INTERVAL_S)
        finally:
            watching.cancel()
            self._end_processes()
            if self._log is not None:
                self._log.close()

    async def wait_for_change(self) -> None:
        """Wait until there is something new to show."""
        await self._changed.wait()

    def picture_at(self, t: float) -> bytes | None:
        """The newest picture not later than `t` [s since the start], as JPEG."""
        if self.view is None or self._log is None:
            return None
        before = [p for p in self.view.pictures if p[0] <= t] or self.view.pictures[:1]
        return self._log.read(before[-1][1]).data.tobytes() if before else None

    def _read(self) -> None:
        log, view, until = self._log, self.view, time.monotonic() + _READ_TIME_S
        assert log is not None and view is not None
        has_news = False
        try:
            for message in self._messages:
                view.update(message, log)
                has_news = True
                if time.monotonic() > until:
                    self.is_behind = True
                    break
            else:
                self.is_behind, self._messages = False, log.poll()
        except (EldirError, OSError) as error:
            self.problem = str(error)
        if view.read_files(log) or has_news:
            self._notify_pages()

    def _notify_pages(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()

    async def _watch_processes(self) -> None:
        while True:
            self._driven = await asyncio.to_thread(self._find_driven)
            self._virtual = await asyncio.to_thread(self._find_virtual)
            ports = list(read_board_hints(self._rig_file).ports) if self._rig_file is not None else []
            folder = None if self._log is None else self._log.path.resolve().parent
            state = await asyncio.to_thread(rig_state, self._driven, self._virtual, ports, folder)
            if state != self.rig_state:
                self.rig_state = state
                self._notify_pages()
            self._follow_newest_log()
            await self._start_processes()
            await asyncio.sleep(_PROCESS_INTERVAL_S)

    def _find_driven(self) -> list[DrivenPort]:
        if self._given_log is not None:
            return [] if self.is_replay else ports_of_log(self._given_log)
        return driven_ports() if self._rig_file is None else ports_of_rig(self._rig_file)

    def _find_virtual(self) -> list[VirtualRun]:
        if self._given_log is not None:
            log = self._given_log.resolve()
            return [] if self.is_replay else [run for run in list_virtual_runs() if run.log == log]
        return list_virtual_runs() if self._rig_file is None else virtual_runs_of(self._rig_file)

    def _follow_newest_log(self) -> None:
        """A new run replaces one that has ended."""
        if self._given_log is not None:
            return
        logs = [log for d in self._driven for log in d.logs] or [run.log for run in self._virtual]
        if logs and (self._log is None or self._log.path.resolve() not in logs):
            with suppress(InputError, OSError):  # it has ended in the meantime
                self._open(max(logs, key=lambda log: log.stat().st_mtime))

    def _open(self, path: Path) -> None:
        log = LogFollower(path)
        log.open()
        _logger.info("following %s", path)
        self._end_processes()
        if self._log is not None:
            self._log.close()
        self._log, self.view, self._messages, self.problem = log, RunView(log.path), log.poll(), None
        self.is_replay = self._given_log is not None and log.is_complete
        self.number += 1
        if not self.is_replay:
            self._on_log(log.path.resolve())

    async def _start_processes(self) -> None:
        """Find the markers once there are pictures, and predict the walk once the robot is known."""
        log, view = self._log, self.view
        if log is None or view is None:
            return
        if self._tracking is None and view.pictures:
            view.tracked_share = 0.0
            self._tracking = await self._start("marker_tracking", log.path, self._take_tracks, view)
        known = log.epoch_ns is not None and log.attachments.keys() >= FILES_OF_A_WALK
        if self._predicting is None and known:
            view.prediction = "computing"
            self._predicting = await self._start("walk_prediction", log.path, self._take_prediction, view)

    async def _start(
        self, module: str, log: Path, take: Callable[[RunView, Any], None], view: RunView
    ) -> asyncio.subprocess.Process:
        """A process that prints JSON lines about a log; `take` gets each of them."""
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            f"eldir_app.watch.{module}",
            str(log.resolve()),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            limit=_MAX_LINE,
        )
        reader = asyncio.create_task(self._read_lines(process, take, view))
        self._readers.add(reader)
        reader.add_done_callback(self._readers.discard)
        return process

    async def _read_lines(
        self, process: asyncio.subprocess.Process, take: Callable[[RunView, Any], None], view: RunView
    ) -> None:
        assert process.stdout is not None
        while line := await process.stdout.readline():
            with suppress(ValueError):
                take(view, json.loads(line))
                self._notify_pages()
        await process.wait()
        if process is self._tracking:
            view.tracked_share = None
            self._notify_pages()

    @staticmethod
    def _take_tracks(view: RunView, row: Any) -> None:
        if isinstance(row, list):
            view.curves["marks"].add(row)
            view.tracked_share = round(min(row[0] / view.pictures[-1][0], 1.0), 2) if row[0] > 0 else 0.0
        elif isinstance(row, dict):
            view.ground = row
        else:
            view.curves["events"].add([view.latest, 0, "marks", row])

    @staticmethod
    def _take_prediction(view: RunView, found: Any) -> None:
        view.prediction = found

    def _end_processes(self) -> None:
        for process in (self._tracking, self._predicting):
            if process is not None and process.returncode is None:
                with suppress(ProcessLookupError):
                    process.kill()
        self._tracking = self._predicting = None

    @property
    def now(self) -> float | None:
        """Time of the run [s since the start]; None for a replay, in virtual time and before the start."""
        epoch = None if self._log is None else self._log.epoch_ns
        if epoch is None or self.is_replay:
            return None
        now = (time.time_ns() - epoch) * 1e-9
        return round(now, 3) if abs(now) < _MAX_RUN_TIME_S else None

    @property
    def has_ended(self) -> bool:
        """Whether the run that is followed has ended."""
        return self._log is None or self._log.is_finished
