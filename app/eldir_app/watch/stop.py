"""Stop heating: `eldir rig off` in a process of its own, which waits neither for this server nor a page.

One such process is loaded beforehand and waits for its words, for loading takes longer than the rest.
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
from typing import NamedTuple

from eldir.core.program_log import VARIABLE

_LONGEST = 20.0  # of `eldir rig off`, whatever hangs [s]
_PATIENCE = 2.0  # with the process that was loaded beforehand; then another one is started [s]
_AT_ONCE = 8  # ports that are stopped side by side
_WAITING = """
import json, sys
import eldir_app.emergency_stop
line = sys.stdin.readline()
if line:
    sys.argv = ["eldir", "rig", "off", *json.loads(line)]
    from eldir_app.main import main
    main()
"""


class Stopped(NamedTuple):
    """What `eldir rig off` said."""

    proven: bool
    """Whether the report of every board says that all contacts are open, and the stop is latched."""
    text: str
    seconds: float


def load() -> subprocess.Popen[bytes]:
    """A process that loads `eldir rig off` and waits for its words. It ends when its input does, as when this
    process has gone."""
    return _start("-c", _WAITING, stdin=subprocess.PIPE)


class Stop:
    """Runs `eldir rig off`; who asks while it runs gets the same outcome."""

    def __init__(self, words: Callable[[], Awaitable[list[list[str]]]], waiting: subprocess.Popen[bytes]):
        """`words`: of each command line behind `eldir rig off`, at the moment of the stop; `waiting`: what
        `load` gave."""
        self._words = words
        self._waiting: subprocess.Popen[bytes] | None = waiting
        self._running: asyncio.Task[Stopped] | None = None
        self._threads = ThreadPoolExecutor(_AT_ONCE, "stop")

    async def stop(self) -> Stopped:
        """Switch off, and tell what was proven. A page that goes away does not end it."""
        if self._running is None or self._running.done():
            self._running = asyncio.create_task(self._stop())
        return await asyncio.shield(self._running)

    async def _stop(self) -> Stopped:
        begun = time.monotonic()
        commands = await self._words()
        if not commands:
            return Stopped(False, "nothing that this page shows is driven: nothing was switched off", 0.0)
        waiting, self._waiting = self._waiting, None
        run = asyncio.get_running_loop().run_in_executor
        loaded = [waiting, *([None] * len(commands[1:]))]
        try:
            ended = await asyncio.gather(
                *(run(self._threads, _off, *one) for one in zip(loaded, commands, strict=True))
            )
        finally:
            self._waiting = load()
        text = "\n".join(said for _, said in ended)
        return Stopped(all(proven for proven, _ in ended), text, round(time.monotonic() - begun, 2))


def _off(waiting: subprocess.Popen[bytes] | None, words: list[str]) -> tuple[bool, str]:
    """Whether everything is proven off, and what was said: by the process that waits, or by a new one where
    that has died or hangs."""
    try:
        if waiting is not None:
            said, _ = waiting.communicate(json.dumps(words).encode() + b"\n", _PATIENCE)
            if said or waiting.returncode == 0:
                return waiting.returncode == 0, said.decode(errors="replace").strip()
    except (OSError, subprocess.TimeoutExpired):
        pass
    new = _start("-m", "eldir", "rig", "off", *words, stdin=subprocess.DEVNULL)
    try:
        said, _ = new.communicate(timeout=_LONGEST)
    except subprocess.TimeoutExpired:
        return False, "eldir rig off does not end; cut the heating supply now"
    return new.returncode == 0, said.decode(errors="replace").strip()


def _start(*words: str, stdin: int) -> subprocess.Popen[bytes]:
    """A Python process that Ctrl-C, which ends the server, does not end."""
    out, err = subprocess.PIPE, subprocess.STDOUT
    quiet = {name: value for name, value in os.environ.items() if name != VARIABLE}  # the page shows it
    return subprocess.Popen(
        [sys.executable, *words], stdin=stdin, stdout=out, stderr=err, start_new_session=True, env=quiet
    )
