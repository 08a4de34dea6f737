"""What heats springs: announced pulses, watched, and everything off on every way out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

from hardware.safety.stop_signals import StoppedError

LEAD = 0.3
"""Pulses are announced at least this long before they begin, so that they begin on time [s]."""


class Report(NamedTuple):
    """What the board reported, and what the model makes of it."""

    t: float
    """[s] on the bank's clock."""
    closed: tuple[bool, ...]
    """Every channel, channel 1 first."""
    temperatures: tuple[float, ...]
    """Of each spring in the rig file's order [C]."""
    hottest: float
    """Highest modelled temperature so far [C]."""
    latest: float
    """Greatest delay of a switching so far [s]."""


See = Callable[[Report], None]


class Bank(ABC):
    """Springs behind a board. Times are on the clock that it was made with; `heat` only while armed."""

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Everything proven off at the start and on every way out; another way than the end is a stop."""
        try:
            self.arm()
            yield
        except BaseException as error:
            self.stop(_reason(error))
            raise
        self.disarm()

    @abstractmethod
    def arm(self) -> None:
        """Prove everything off; refused while a stop is latched."""

    @abstractmethod
    def heat(self, at: float, lengths: Mapping[int, float]) -> None:
        """Announce pulses: these channels close at `at`, and open after so many seconds."""

    @abstractmethod
    def cut(self) -> None:
        """Open all that heats now, and forget what was announced."""

    @abstractmethod
    def rest_until(self, t: float, see: See) -> None:
        """Keep the heat alive until `t`, and show what is reported meanwhile."""

    @abstractmethod
    def disarm(self) -> None:
        """Everything proven off: the good end."""

    @abstractmethod
    def stop(self, why: str) -> None:
        """Everything off now, proven, and latched until it is reset. Harmless when it has happened."""


def _reason(error: BaseException) -> str:
    if isinstance(error, KeyboardInterrupt):
        return "stopped by Ctrl-C"
    if isinstance(error, StoppedError):
        return error.reason
    return str(error) or type(error).__name__
