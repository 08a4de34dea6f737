"""Questions at a terminal, whose answers may also be options of the command."""

from __future__ import annotations

import os
import select
import sys
import termios
from collections.abc import Callable
from contextlib import suppress
from math import isfinite
from typing import TypeVar

import typer

from eldir.errors import EldirError, InputError

_Answer = TypeVar("_Answer")
UNKNOWN = "unknown"
"""Answer for a value that was not measured yet."""
_YES_NO = {"y": True, "yes": True, "n": False, "no": False}
_LINE_BYTES = 4096  # a terminal passes on lines of at most this length


class Dialogue:
    """Asks at the terminal of stdin; without one it refuses a missing answer and names its option.

    Lines are read without Python's buffer, so that `poll_line` does not wait for one.
    """

    def __init__(self, handle: int | None = None):
        """`handle`: of the terminal; default: stdin if it is one."""
        if handle is None and sys.stdin and sys.stdin.isatty():
            handle = sys.stdin.fileno()
        self._handle = handle
        self._pending = b""

    @property
    def is_interactive(self) -> bool:
        """Whether there is a terminal to ask at."""
        return self._handle is not None

    def say(self, text: str, *, newline: bool = True) -> None:
        """Write on stderr."""
        typer.echo(text, nl=newline, err=True)

    def ask(
        self,
        option: str,
        given: str | None,
        question: str,
        accept: Callable[[str], _Answer],
        default: str | None = None,
    ) -> _Answer:
        """What `accept` makes of the answer; it raises `EldirError` for one that it refuses.

        A refused answer at the terminal is asked for again. Raises `typer.BadParameter` for a refused option,
        and for a missing one without a terminal.
        """
        if given is not None:
            try:
                return accept(given.strip())
            except EldirError as error:
                raise typer.BadParameter(str(error), param_hint=option) from None
        if not self.is_interactive:
            raise typer.BadParameter("its answer is missing, and there is no terminal", param_hint=option)
        while True:
            shown = "" if default is None else f" [{default}]"
            self.say(f"{question}{shown}: ", newline=False)
            if not (answer := self.read_line() or default):
                self.say("an answer is needed")
                continue
            try:
                return accept(answer)
            except EldirError as error:
                self.say(str(error))

    def confirm(self, question: str) -> bool:
        """The answer to a question of yes or no that is typed now; no is the default."""
        self.discard()
        return self.ask("", None, question, parse_yes_no, "no")

    def wait_for_enter(self, request: str) -> None:
        """Wait until the person has done something."""
        self.discard()
        self.say(f"{request}, then press Enter: ", newline=False)
        self.read_line()

    def read_line(self) -> str:
        """The next line that is typed, without spaces around it. Raises `EldirError` at its end (Ctrl-D)."""
        while (line := self.poll_line()) is None:
            select.select([self._terminal], [], [])
        return line

    def poll_line(self) -> str | None:
        """A line that was typed, as of `read_line`; None if there is none yet."""
        if b"\n" not in self._pending and select.select([self._terminal], [], [], 0)[0]:
            data = b""
            with suppress(OSError):  # EIO: the terminal was closed
                data = os.read(self._terminal, _LINE_BYTES)
            if not data:
                raise EldirError("the terminal has ended", remedy="run the command again to continue")
            self._pending += data
        line, end, rest = self._pending.partition(b"\n")
        if not end:
            return None
        self._pending = rest
        return line.decode(errors="replace").strip()

    def discard(self) -> None:
        """Forget what was typed before a question was shown: it may not answer that question."""
        termios.tcflush(self._terminal, termios.TCIFLUSH)
        self._pending = b""

    @property
    def _terminal(self) -> int:
        if self._handle is None:
            raise EldirError("there is no terminal", remedy="run the command in a terminal")
        return self._handle


def parse_yes_no(answer: str) -> bool:
    """Yes or no. Raises `InputError` for anything else."""
    if (found := _YES_NO.get(answer.lower())) is None:
        raise InputError("invalid answer", expected="yes or no", found=repr(answer))
    return found


def parse_choice(answer: str, choices: tuple[str, ...]) -> str:
    """One of the choices. Raises `InputError` for anything else."""
    if answer not in choices:
        raise InputError("invalid answer", expected=", ".join(choices), found=repr(answer))
    return answer


def parse_number(answer: str) -> float:
    """A finite number, also with a decimal comma; whole ones as int. Raises `InputError`."""
    with suppress(ValueError):
        if isfinite(value := float(answer.replace(",", "."))):
            return int(value) if value.is_integer() else value
    raise InputError("invalid number", expected="one such as 3.6", found=repr(answer))


def parse_measured(answer: str) -> float | None:
    """A finite number; None for "unknown". Raises `InputError`."""
    return None if answer == UNKNOWN else parse_number(answer)
