"""Signals that end the program, held back while it switches everything off."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from eldir.errors import EldirError, report

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


class StoppedError(EldirError):
    """The program was asked to stop."""

    code = "run.stopped"

    def __init__(self, reason: str):
        self.reason = reason
        super().__init__(reason, remedy="everything was switched off")


def _heard(number: signal.Signals) -> bool:
    """Whether a signal is handled. A program started with nohup ignores a closed terminal."""
    return number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN


class Stop:
    """Converts signals to exceptions while the player runs, never while it switches everything off."""

    def __init__(self) -> None:
        self._asked: int | None = None
        self._heeding = False

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Handle the signals that would end the program; one outside `heeded` is raised at the end.

        An error is printed here, before the handlers are as before: a repeated signal can then only shorten
        what follows, such as the end of the log.
        """
        if threading.current_thread() is not threading.main_thread():  # which alone may handle signals
            yield
            return
        before = {s: signal.signal(s, self._on_signal) for s in _ENDING if _heard(s)}
        try:
            yield
            self._raise_if_asked()
        except BaseException as error:
            report(error)
            raise
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def heeded(self) -> Iterator[None]:
        """Raise a signal as soon as it comes, but only the first."""
        self._raise_if_asked()
        self._heeding = True
        try:
            yield
        finally:
            self._heeding = False

    def _on_signal(self, number: int, _frame: object) -> None:
        first = self._asked is None
        self._asked = self._asked or number
        if first and self._heeding:
            self._raise_if_asked()

    def _raise_if_asked(self) -> None:
        if self._asked == signal.SIGINT:
            raise KeyboardInterrupt
        if self._asked is not None:
            raise StoppedError(f"stopped by {signal.Signals(self._asked).name}")


@contextmanager
def signals_as_errors() -> Iterator[None]:
    """SIGTERM and a closed terminal raise an error, as Ctrl-C does: files are closed, and the status is 1."""

    def on_signal(number: int, _frame: object) -> None:
        raise EldirError(f"stopped by {signal.Signals(number).name}")

    before = {s: signal.signal(s, on_signal) for s in (signal.SIGTERM, signal.SIGHUP) if _heard(s)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
