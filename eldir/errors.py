"""Errors that a user may meet. Each prints one line: what happened, what was expected, what was found, what
to do. An error about heat is printed before any other."""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import TextIO

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Numbers of the errors of a file, a stream or the user's share that has no more room."""

_LONGEST = 400  # characters of what was found
_PRINTED = "printed_lines"  # an attribute of an error


class EldirError(Exception):
    """A failure that the user can act on; the command prints it in one line and exits with 1.

    Programs tell failures by their type and `code` (docs/reference/errors.md); the sentences may change.
    """

    code: str = "failure"
    """What failed, for programs."""
    key: str | None = None
    """The argument, or the entry of a file or record, such as "supply.voltage_v"; or None."""

    def __init__(
        self,
        problem: str,
        *,
        code: str | None = None,
        key: str | None = None,
        expected: str | None = None,
        found: str | None = None,
        remedy: str | None = None,
    ):
        if code is not None:
            self.code = code
        if key is not None:
            self.key = key
        parts = [problem]
        if expected is not None:
            parts.append(f"expected {expected}")
        if found is not None:
            parts.append(f"found {_shortened(found)}")
        if remedy is not None:
            parts.append(remedy)
        super().__init__("; ".join(parts))


def _shortened(found: str) -> str:
    """What was found, on one line of a readable length: it may come from a damaged file."""
    line = " ".join(found.split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 3]}..."


class HazardError(EldirError):
    """Heat may be on, or is not what was ordered: a person may have to act at once.

    Its line is printed first, also where another error has taken its place meanwhile.
    """

    code = "hazard"


class InputError(EldirError):
    """An argument, an option or a file is invalid."""

    code = "input"


class MissingDependencyError(EldirError):
    """An optional package is needed, and it is not installed."""

    code = "missing-package"


def missing(path: object, remedy: str | None = "check the path") -> InputError:
    """The error for a file or folder that does not exist."""
    return InputError(f"{path} does not exist", code="file.missing", remedy=remedy)


def not_read(path: object, error: Exception, remedy: str | None = "check the path") -> InputError:
    """The error for a file that the system does not read; `remedy` is for one that is missing."""
    if isinstance(error, FileNotFoundError):
        return missing(path, remedy)
    return InputError(f"cannot read {path}: {_reason(error)}", code="file.not-read")


def not_written(path: object, error: Exception | str, remedy: str | None = None) -> EldirError:
    """The error for a file or folder that the system does not write."""
    return EldirError(f"cannot write {path}: {_reason(error)}", code="file.not-written", remedy=remedy)


def damaged(
    what: object, expected: str | None = None, found: str | None = None, remedy: str | None = None
) -> InputError:
    """The error for bytes that are no whole file of their kind."""
    problem = f"{what} is damaged"
    return InputError(problem, code="file.damaged", expected=expected, found=found, remedy=remedy)


def empty(path: object, expected: str, remedy: str | None = None) -> InputError:
    """The error for a file without a byte."""
    problem = f"{path} is empty"
    return InputError(problem, code="file.empty", expected=expected, found="0 bytes", remedy=remedy)


def divergence_error(what: str) -> EldirError:
    """The error for a simulation that diverged."""
    return EldirError(f"{what} diverged", code="motion.blown-up", remedy="choose another design or seed")


def _reason(error: Exception | str) -> str:
    """What the system says, without the number and the name of the file."""
    return str(getattr(error, "strerror", None) or error)


def report(error: BaseException) -> None:
    """Print one line for each hazard behind an error, then one for the error itself. Never raises.

    The notes of an error stand on its line. What was printed once is not printed again. An error without
    notes that is no `EldirError` gets no line: its traceback follows, or a line of whoever handles it.
    """
    lines = [line for failure in _chain(error) for line in vars(failure).get(_PRINTED, ())]
    for failure in _failures(error):
        notes = list(getattr(failure, "__notes__", ()))
        if not notes and not isinstance(failure, EldirError):
            continue
        parts = [p for p in (_words(failure), *notes) if not any(p in line for line in lines)]
        if parts:
            line = "; ".join(parts)
            print_line(line, hazard=isinstance(failure, HazardError))
            vars(failure).setdefault(_PRINTED, []).append(line)
            lines.append(line)


def describe(error: BaseException) -> str:
    """An error and every hazard behind it in one text, the hazards first."""
    parts: list[str] = []
    for failure in _failures(error):
        if not any(_words(failure) in part for part in parts):
            parts.append(_words(failure))
    return "; ".join(parts)


def print_line(text: str, hazard: bool = False) -> None:
    """Print one line on stderr. Never raises: the terminal may be closed, or the disk full.

    A `hazard` is printed on stdout too where only that is a terminal, and on the terminal itself where stderr
    cannot be written.
    """
    line = "eldir: " + " ".join(text.split())
    printed = _print(line, sys.stderr)
    if not hazard or (printed and sys.stderr.isatty()):
        return
    if sys.stdout.isatty():
        _print(line, sys.stdout)
    elif not printed:
        with suppress(OSError), open("/dev/tty", "w") as terminal:
            _print(line, terminal)


def _print(line: str, stream: TextIO) -> bool:
    """Whether the line was written."""
    try:
        print(line, file=stream, flush=True)
    except (OSError, ValueError, SystemExit):  # rich ends the program where a pipe is broken
        return False
    return True


def _failures(error: BaseException) -> list[BaseException]:
    """The hazards behind an error, then the error itself and what bears a note."""
    failures = [f for f in _chain(error) if f is error or isinstance(f, HazardError) or _is_noted(f)]
    return sorted(failures, key=lambda f: not isinstance(f, HazardError))


def _chain(error: BaseException) -> Iterator[BaseException]:
    """The error, and every one that it has replaced or gathers."""
    waiting: list[BaseException | None] = [error]
    found: list[BaseException] = []
    while waiting:
        failure = waiting.pop(0)
        if failure is not None and not any(failure is f for f in found):
            found.append(failure)
            yield failure
            waiting += [failure.__cause__, failure.__context__, *getattr(failure, "exceptions", ())]


def _is_noted(error: BaseException) -> bool:
    return isinstance(error, EldirError | KeyboardInterrupt) and hasattr(error, "__notes__")


def _words(error: BaseException) -> str:
    if isinstance(error, KeyboardInterrupt):
        return "stopped by Ctrl-C"
    return str(error) if isinstance(error, EldirError) else f"{type(error).__name__}: {error}"
