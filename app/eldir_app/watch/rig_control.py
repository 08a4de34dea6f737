"""Stops and starts heating for the page: `eldir rig off` and `eldir rig drive` in processes of their own.

A stop waits neither for this server nor for a page; one such process is loaded beforehand and waits for its
arguments, because loading takes longer than the rest. A run that the page started goes on when the server
dies.
"""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from eldir.core.program_log import VARIABLE
from eldir.errors import EldirError, InputError
from eldir_hardware.rig._board_hints import read_board_hints
from eldir_hardware.run.virtual_runs import VirtualRun, end_virtual_run
from eldir_hardware.safety.latch import latched_error, read_stop
from eldir_hardware.schedule import ActuationSchedule

_OFF_TIMEOUT_S = 20.0  # of `eldir rig off`
_LOADED_TIMEOUT_S = 3.5  # of the loaded process, which may wait for a sensor; then a new one is started
_MAX_PARALLEL_STOPS = 8
_LOADED_PROGRAM = """
import json, sys
import eldir_app.emergency_stop, eldir_hardware.guardian.measured_heat
line = sys.stdin.readline()
if line:
    sys.argv = ["eldir", "rig", "off", *json.loads(line)]
    from eldir_app.main import main
    main()
"""
_MAX_FAILURE_LENGTH = 400  # [characters]


class StopResult(NamedTuple):
    """Result of `eldir rig off`."""

    proven: bool
    """Whether every board reports all contacts open, no sensor measures current and the stop is latched, and
    every run in virtual time has ended."""
    text: str
    seconds: float


def load() -> subprocess.Popen[bytes]:
    """A process that loads `eldir rig off` and waits for its arguments. It ends with its input, so also when
    this process dies."""
    return _start_python("-c", _LOADED_PROGRAM, stdin=subprocess.PIPE)


class EmergencyStop:
    """Runs `eldir rig off`; all requests while it runs get the same result."""

    def __init__(
        self,
        arguments: Callable[[], Awaitable[list[list[str]]]],
        virtual_runs: Callable[[], Awaitable[list[VirtualRun]]],
        loaded: subprocess.Popen[bytes],
    ):
        """`arguments`: gives those of each `eldir rig off` to run, at the moment of the stop. `virtual_runs`:
        gives the runs in virtual time to end then, which have no port. `loaded`: the process from `load`."""
        self._arguments, self._virtual_runs = arguments, virtual_runs
        self._loaded: subprocess.Popen[bytes] | None = loaded
        self._running: asyncio.Task[StopResult] | None = None
        self._threads = ThreadPoolExecutor(_MAX_PARALLEL_STOPS, "stop")

    async def stop(self) -> StopResult:
        """Switch off. A page that is closed does not cancel it."""
        if self._running is None or self._running.done():
            self._running = asyncio.create_task(self._stop())
        return await asyncio.shield(self._running)

    async def _stop(self) -> StopResult:
        start = time.monotonic()
        commands = await self._arguments()
        outcomes = [] if not commands else await self._run_commands(commands)
        for run in await self._virtual_runs():  # after the boards: they heat nothing
            outcomes.append(await asyncio.to_thread(_end_run, run))
        if not outcomes:
            return StopResult(False, "nothing on this page is being driven: nothing was switched off", 0.0)
        text = "\n".join(output for _, output in outcomes)
        return StopResult(all(proven for proven, _ in outcomes), text, round(time.monotonic() - start, 2))

    async def _run_commands(self, commands: list[list[str]]) -> list[tuple[bool, str]]:
        loaded, self._loaded = self._loaded, None
        run = asyncio.get_running_loop().run_in_executor
        processes = [loaded, *([None] * len(commands[1:]))]
        try:
            return await asyncio.gather(
                *(run(self._threads, _run_off, *job) for job in zip(processes, commands, strict=True))
            )
        finally:
            self._loaded = load()


def _end_run(run: VirtualRun) -> tuple[bool, str]:
    """Whether a run in virtual time has ended, and a sentence."""
    try:
        return True, end_virtual_run(run)
    except EldirError as error:
        return False, str(error)


def _run_off(loaded: subprocess.Popen[bytes] | None, arguments: list[str]) -> tuple[bool, str]:
    """Whether everything is proven off, and the output: of the loaded process, or of a new one if there is
    none, or it has died or hangs."""
    try:
        if loaded is not None:
            output, _ = loaded.communicate(json.dumps(arguments).encode() + b"\n", _LOADED_TIMEOUT_S)
            if output or loaded.returncode == 0:
                return loaded.returncode == 0, output.decode(errors="replace").strip()
    except (OSError, subprocess.TimeoutExpired):
        pass
    new = _start_python("-m", "eldir", "rig", "off", *arguments, stdin=subprocess.DEVNULL)
    try:
        output, _ = new.communicate(timeout=_OFF_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return False, "eldir rig off does not end; cut the heating supply now"
    return new.returncode == 0, output.decode(errors="replace").strip()


def _start_python(*arguments: str, stdin: int) -> subprocess.Popen[bytes]:
    """A Python process that Ctrl-C, which ends the server, does not end. It logs nothing: the page shows all
    of its output."""
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    return subprocess.Popen(
        [sys.executable, *arguments],
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        env=environment,
    )


class ScheduleStart:
    """Starts the one schedule that `--allow-start` names, and tells how it ended."""

    def __init__(self, rig: Path, schedule: Path):
        """Raises `InputError` if the schedule cannot be read."""
        ActuationSchedule.load(schedule)
        self.rig, self.schedule = rig.resolve(), schedule.resolve()
        self._running: subprocess.Popen[bytes] | None = None
        self._output = Path()

    def start(self, driven: bool) -> None:
        """Start the schedule, and return at once. Raises `EldirError` if a rig is `driven` already or a stop
        is latched; the guardian, which alone closes contacts, checks both again."""
        if driven or self.is_running:
            raise InputError("a rig is being driven already", remedy="wait for the end of the run")
        for port in read_board_hints(self.rig).ports:
            if (why := read_stop(port)) is not None:
                raise latched_error(port, why)
        now = datetime.now().strftime("%Y-%m-%d-%H%M%S")
        log = self.schedule.with_name(f"{self.schedule.stem}-{now}.mcap")
        self._output = log.with_suffix(".txt")
        arguments = [str(self.schedule), "--rig", str(self.rig), "--log", str(log)]
        with self._output.open("xb") as output:
            self._running = subprocess.Popen(
                [sys.executable, "-m", "eldir", "rig", "drive", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C ends the server, not the run
            )

    @property
    def is_running(self) -> bool:
        """Whether the run that was started has not ended yet."""
        return self._running is not None and self._running.poll() is None

    @property
    def failure(self) -> str | None:
        """The error message of the last run, if it failed."""
        if self._running is None or not self._running.poll():
            return None
        lines = self._output.read_text(errors="replace").strip().splitlines()
        return (
            "\n".join(line for line in lines if line.startswith("eldir:"))[-_MAX_FAILURE_LENGTH:]
            or "the run failed without a message"
        )
