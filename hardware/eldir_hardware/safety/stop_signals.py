"""Signals that end the program, delayed while it switches everything off."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from eldir.errors import EldirError, report

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


class StoppedError(EldirError):
    """The program was asked to stop."""

    code = "run.stopped"

    def __init__(self, reason: str):
        self.reason = reason
        super().__init__(reason, remedy="everything was switched off")


def _is_handled(number: signal.Signals) -> bool:
    """Whether to handle a signal: a program that was started with nohup ignores a closed terminal."""
    return number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN


class StopSignals:
    """Converts signals to exceptions during a run, but not while it switches everything off."""

    def __init__(self) -> None:
        self._received: int | None = None
        self._is_raising = False

    @contextmanager
    def handled(self) -> Iterator[None]:
        """Handle the signals that would end the program; one outside of `raising` is raised at the end.

        An error is printed before the handlers are restored: a repeated signal then only interrupts what
        follows, such as the end of the log.
        """
        # Only the main thread may handle signals.
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {s: signal.signal(s, self._on_signal) for s in _SIGNALS if _is_handled(s)}
        try:
            yield
            self._raise_received()
        except BaseException as error:
            report(error)
            raise
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def raising(self) -> Iterator[None]:
        """Raise a signal as soon as it comes, but only the first."""
        self._raise_received()
        self._is_raising = True
        try:
            yield
        finally:
            self._is_raising = False

    def _on_signal(self, number: int, _frame: object) -> None:
        first = self._received is None
        self._received = self._received or number
        if first and self._is_raising:
            self._raise_received()

    def _raise_received(self) -> None:
        if self._received == signal.SIGINT:
            raise KeyboardInterrupt
        if self._received is not None:
            raise StoppedError(f"stopped by {signal.Signals(self._received).name}")


@contextmanager
def signals_as_errors() -> Iterator[None]:
    """Raise an error at SIGTERM and a closed terminal, as at Ctrl-C: files are closed, the status is 1."""

    def on_signal(number: int, _frame: object) -> None:
        raise EldirError(f"stopped by {signal.Signals(number).name}")

    before = {s: signal.signal(s, on_signal) for s in (signal.SIGTERM, signal.SIGHUP) if _is_handled(s)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
