"""The program `eldir`: turns every failure into one line and a status.

The emergency stop does not wait until the other commands are loaded.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
from contextlib import suppress
from io import TextIOWrapper
from typing import NoReturn

from eldir.core import program_log
from eldir.errors import EldirError, InputError, print_line, report

_FULL = (errno.ENOSPC, errno.EDQUOT)
_EMERGENCY = ["rig", "off"]


def main() -> NoReturn:
    """Run the command; status 0 only when it did what it says, 2 for wrong arguments, 130 for Ctrl-C."""
    if sys.platform == "win32":  # files are locked, ports and processes held, as Linux does it
        print_line("eldir does not run on Windows; expected Linux; use WSL or a container")
        sys.exit(1)
    _open_streams()
    status: int | str | None
    try:
        status = _run(sys.argv[1:])
    except BaseException as error:
        try:
            _ignore_signals()
        except KeyboardInterrupt:  # one that came just before
            _ignore_signals()
        report(error)
        status = _status(error)
    sys.exit(status)


def _run(words: list[str]) -> int:
    """The status of the command. Raises what it raises."""
    status = _emergency_stop(words)
    if status is None:
        from eldir_app.terminal.interruption import hold_back_during_imports

        hold_back_during_imports()
        from eldir_app.application import run_application

        status = run_application()
    sys.stdout.flush()  # what does not fit is told here, not after the end
    return status


def _ignore_signals() -> None:
    """What was stopped ends now, and its last lines and its status must not depend on one more signal."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


def _status(error: BaseException) -> int | str | None:
    """The status after an error, which is printed if it was not yet. A fault of the program is raised."""
    match error:
        case KeyboardInterrupt():
            print_line("stopped")
            return 130
        case SystemExit():
            return error.code
        case EldirError():
            return 1
        case BrokenPipeError():  # such as `eldir ... | head`
            sys.stderr.close()
            return 1
        case OSError() if error.errno in _FULL:
            with suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # else the rest is tried once more at the end
            print_line(f"cannot write: {error.strerror}; make room")
            return 1
    raise error


def _open_streams() -> None:
    """Replace streams that the caller closed, before a file gets their numbers and is written into, and write
    names of files that are not UTF-8 escaped instead of failing there."""
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode)  # noqa: SIM115  # of the lowest number that is free
            if stream.fileno() == number:
                os.set_inheritable(number, True)
            setattr(sys, name, stream)
    for output in (sys.stdout, sys.stderr):
        if isinstance(output, TextIOWrapper):
            output.reconfigure(errors="backslashreplace")


def _emergency_stop(words: list[str]) -> int | None:
    """The status of `eldir rig off`; None for any other command, and for options that the long way explains.

    Loading the other commands takes longer than a spring needs to get too hot.
    """
    steps = sum(map(_log_steps, words))
    words = [word for word in words if not _log_steps(word)]
    if words[:2] != _EMERGENCY:
        return None
    with suppress(OSError, AttributeError):  # where this user may ask for that, no other program delays it
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    here = os.getcwd()
    beside = [p for p in sys.path if not os.path.isabs(p) or os.path.realpath(p) == here]
    sys.path[:] = [
        p for p in sys.path if p not in beside
    ] + beside  # a serial.py beside the rig file is not run
    try:
        from eldir_app.emergency_stop import run_quickly
    except KeyboardInterrupt as error:
        error.add_note("nothing was switched off yet: run it again, or cut the heating supply now")
        raise
    if steps:
        with suppress(InputError):  # of ELDIR_LOG, which is told below
            program_log.raise_level(steps)
    program_log.configure("eldir rig off")
    return run_quickly(words[2:])


def _log_steps(word: str) -> int:
    """How often a word says -v."""
    if word[:2] == "-v" and word.strip("v") == "-":
        return len(word) - 1
    return int(word == "--verbose")
