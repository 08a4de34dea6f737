"""The program `eldir`: turns every failure into one line and an exit status.

The emergency stop does not wait until the other commands are loaded.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from io import TextIOWrapper
from types import FrameType
from typing import NoReturn

from eldir.core import program_log
from eldir.errors import DISK_FULL, EldirError, InputError, print_line, report

_EMERGENCY_STOP = ["rig", "off"]
_RETRY_INTERVAL_S = 0.05  # of a Ctrl-C that came during an import


def main() -> NoReturn:
    """Run the command. Exit status: 0 only for success, 2 for invalid arguments, 130 for Ctrl-C."""
    if sys.platform == "win32":  # locks, ports and processes work as on Linux
        print_line("eldir does not run on Windows; expected Linux; use WSL or a container")
        sys.exit(1)
    # Other threads of OpenBLAS wait in a loop: a spring's fit takes twice the processor time with them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _repair_streams()
    status: int | str | None
    try:
        status = _run(sys.argv[1:])
    except BaseException as error:
        try:
            _ignore_signals()
        except KeyboardInterrupt:  # a signal that arrived just before
            _ignore_signals()
        report(error)
        try:
            status = _exit_status(error)
        finally:
            _drop_unwritable()
    sys.exit(status)


def _run(arguments: list[str]) -> int:
    """The exit status of the command. Raises whatever the command raises."""
    status = _run_emergency_stop(arguments)
    if status is None:
        _defer_interrupts_during_imports()
        from eldir_app.application import run_application

        status = run_application()
    sys.stdout.flush()  # a full disk is reported here, not by the interpreter at exit
    return status


def _ignore_signals() -> None:
    """A second signal must not cut off the last lines or change the exit status."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


def _exit_status(error: BaseException) -> int | str | None:
    """The exit status after an error; prints what was not printed yet. A bug of the program is raised."""
    match error:
        case KeyboardInterrupt():
            print_line("stopped")
            return 130
        case SystemExit():
            return error.code
        case EldirError():
            return 1
        case BrokenPipeError():  # such as `eldir ... | head`
            return 1
        case OSError() if error.errno in DISK_FULL:
            print_line(f"cannot write: {error.strerror}; make room")
            return 1
    raise error


def _drop_unwritable() -> None:
    """Discard what a full disk, a closed pipe or terminal does not take: else the interpreter tries once more
    at its end, complains, and changes the exit status."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _repair_streams() -> None:
    """Open streams that the caller closed on the null device, before a file gets their descriptors and is
    written into. Escape characters that the terminal cannot encode, instead of failing."""
    for descriptor, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode)  # noqa: SIM115  # gets the lowest free descriptor
            if stream.fileno() == descriptor:
                os.set_inheritable(descriptor, True)
            setattr(sys, name, stream)
    for output in (sys.stdout, sys.stderr):
        if isinstance(output, TextIOWrapper):
            output.reconfigure(errors="backslashreplace")


def _run_emergency_stop(arguments: list[str]) -> int | None:
    """The exit status of `eldir rig off`; None for other commands, and for options that only the full command
    explains.

    Loading the other commands takes longer than a spring needs to overheat.
    """
    verbosity = sum(map(_count_verbose, arguments))
    arguments = [argument for argument in arguments if not _count_verbose(argument)]
    if arguments[:2] != _EMERGENCY_STOP:
        return None
    _move_working_directory_last()
    try:
        from eldir_hardware.realtime import COMMANDS, request_realtime_priority

        request_realtime_priority(COMMANDS)
        from eldir_app.emergency_stop import run_quickly
    except KeyboardInterrupt as error:
        error.add_note("nothing was switched off yet: run it again, or cut the heating supply now")
        raise
    if verbosity:
        with suppress(InputError):  # an invalid ELDIR_LOG, which `configure` reports
            program_log.raise_level(verbosity)
    program_log.configure("eldir rig off")
    return run_quickly(arguments[2:])


def _move_working_directory_last() -> None:
    """Search the working directory last, so that a serial.py beside the rig file is not imported."""
    here = os.getcwd()
    local = [p for p in sys.path if not os.path.isabs(p) or os.path.realpath(p) == here]
    sys.path[:] = [p for p in sys.path if p not in local] + local


def _count_verbose(argument: str) -> int:
    """How many times an argument is -v: 2 for -vv."""
    if argument[:2] == "-v" and argument.strip("v") == "-":
        return len(argument) - 1
    return int(argument == "--verbose")


def _defer_interrupts_during_imports() -> None:
    """Defer the first Ctrl-C until the import that it interrupts is complete. The second one acts at once.

    Some packages (trimesh) catch every exception of an import, KeyboardInterrupt included, and continue
    without the module; the rig would then be driven to the end.
    """
    # A program in the background ignores Ctrl-C already.
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    deferred = False

    def on_interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal deferred
        if deferred or not _is_importing(frame):
            raise KeyboardInterrupt
        deferred = True
        signal.setitimer(signal.ITIMER_REAL, _RETRY_INTERVAL_S, _RETRY_INTERVAL_S)

    def on_timer(number: int, frame: FrameType | None) -> None:
        if not _is_importing(frame):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.raise_signal(signal.SIGINT)

    signal.signal(signal.SIGINT, on_interrupt)
    signal.signal(signal.SIGALRM, on_timer)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
