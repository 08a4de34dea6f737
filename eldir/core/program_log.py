"""What the program does: records of `logging`, written to stderr as lines. A run's log is another thing.

`ELDIR_LOG` and the option -v choose what is written; the programs that a command starts inherit it. Only a
program configures this, a library never does. Nobody waits for stderr: the guardian writes there too, and
heat must not stay on because a pipe is full or a terminal stands still.
"""

from __future__ import annotations

import io
import logging
import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress

from eldir.core.arguments import require_value
from eldir.errors import InputError

VARIABLE = "ELDIR_LOG"
PACKAGES = ("eldir", "eldir_cad", "eldir_hardware", "eldir_calibration", "eldir_app", "eldir_ros")
"""The packages that a level without a module is for."""
_LEVELS = {"error": logging.ERROR, "warning": logging.WARNING, "info": logging.INFO, "debug": logging.DEBUG}
_STEPS = ("warning", "info", "debug")  # of -v
_QUIET = "eldir: %(message)s"
_DETAILED = "%(asctime)s.%(msecs)03d %(levelname)-7s {} %(name)s: %(message)s"
_LONGEST = 4096  # what a pipe takes as one piece [bytes]
_logger = logging.getLogger(__name__)


def configure(program: str, handler: logging.Handler | None = None) -> None:
    """Write the records of this process to stderr, or give them to `handler`, at the levels of `ELDIR_LOG`.

    `program` stands in each line. Without `ELDIR_LOG` there are only warnings, without time and module; a
    wrong one counts as none, and is a warning.
    """
    problem, levels = "", {}
    try:
        levels = read_levels()
    except InputError as error:
        problem = f"{error}; only warnings are written"
    if handler is None:
        handler = logging.StreamHandler(UnblockedStderr())
        handler.setFormatter(logging.Formatter(_DETAILED.format(program) if levels else _QUIET, "%H:%M:%S"))
    handler.set_name(__name__)
    root = logging.getLogger()
    for before in [h for h in root.handlers if h.name == __name__]:
        root.removeHandler(before)
    root.addHandler(handler)
    logging.raiseExceptions = False  # a record that cannot be written is no reason for a traceback
    everywhere = levels.pop("", "warning")
    for name, level in {**dict.fromkeys(PACKAGES, everywhere), **levels}.items():
        logging.getLogger(name).setLevel(_LEVELS[level])
    if problem:
        _logger.warning(problem)


def is_detailed() -> bool:
    """Whether more than warnings is written."""
    return bool(os.environ.get(VARIABLE))


def raise_level(steps: int) -> None:
    """Take so many steps from warning to info and debug in `ELDIR_LOG`. Levels of single modules stay.

    Raises `InputError` as `read_levels`.
    """
    levels = read_levels()
    now = levels.pop("", "warning")
    first = _STEPS.index(now) if now in _STEPS else 0
    words = [f"{name}={level}" for name, level in levels.items()]
    os.environ[VARIABLE] = ",".join([*words, _STEPS[min(first + steps, len(_STEPS) - 1)]])


def read_levels() -> dict[str, str]:
    """The level of each module that `ELDIR_LOG` names, and of "" for all others. Raises `InputError`."""
    levels = {}
    for entry in filter(None, (e.strip() for e in os.environ.get(VARIABLE, "").split(","))):
        name, _, level = (part.strip() for part in entry.rpartition("="))
        expected = f"{', '.join(_LEVELS)}, or MODULE=LEVEL, separated by commas"
        require_value(VARIABLE, level.lower() in _LEVELS, expected, repr(entry))
        expected = "an installed module or package before =, such as eldir_hardware.relay"
        require_value(VARIABLE, not name or _is_module(name), expected, repr(name))
        levels[name] = level.lower()
    return levels


def _is_module(name: str) -> bool:
    """Whether a module of that name is installed. It is not imported."""
    from importlib.machinery import PathFinder
    from importlib.util import find_spec

    top, *below = name.split(".")
    with suppress(ImportError, ValueError):
        found = find_spec(top)
        for part in below:
            within = found and found.submodule_search_locations
            found = PathFinder.find_spec(f"{found.name}.{part}", within) if found and within else None
        return found is not None
    return False


class UnblockedStderr(io.TextIOBase):
    """Standard error, never waited for: a line that it does not take at once is left out, and the next one
    says how many were."""

    def __init__(self) -> None:
        self._send = _sender()
        self._left_out, self._cut = 0, b""

    def write(self, text: str) -> int:
        data = text.encode(errors="backslashreplace")
        if self._left_out:
            data = b"%seldir: left out %d lines of the log\n%s" % (self._cut, self._left_out, data)
        if len(data) > _LONGEST:
            data = data[: _LONGEST - 4] + b"...\n"
        try:
            taken = self._send(data)
            self._left_out, self._cut = 0, b"" if taken == len(data) else b"\n"
        except OSError:
            self._left_out += 1
        return len(text)

    def isatty(self) -> bool:
        return os.isatty(2)

    def fileno(self) -> int:
        return 2


def _sender() -> Callable[[bytes], int]:
    """Writes what stderr takes at once. Other programs share it, so it is not made non-blocking itself."""
    # Closed by the caller: the next file that is opened, such as a port, has its number.
    if sys.stderr is None:
        return len
    mode = os.fstat(2).st_mode
    if stat.S_ISREG(mode):  # one that is opened again would be written from its beginning
        return lambda data: os.write(2, data)
    if stat.S_ISSOCK(mode):
        import socket

        end = socket.socket(fileno=os.dup(2))
        return lambda data: end.send(data, socket.MSG_DONTWAIT)
    try:
        handle = os.open("/proc/self/fd/2", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except OSError:  # another user's, as in a container: a pipe can still be asked not to wait
        return lambda data: os.pwritev(2, [data], -1, os.RWF_NOWAIT)
    return lambda data: os.write(handle, data)
