"""Interface to heat springs: announce pulses, watch them, and switch everything off at the end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.safety.stop_signals import StoppedError

BY_THE_BOARD = "all contacts are open by the board's report"
LEAD = 0.3
"""Pulses are announced at least this long before they begin, so that they begin on time [s]."""


class Report(NamedTuple):
    """A read-back of the board, and the model's temperatures."""

    t: float
    """Time on the bank's clock [s]."""
    closed: tuple[bool, ...]
    """Whether each channel is closed, channel 1 first."""
    temperatures: tuple[float, ...]
    """Modelled temperature of each spring, in the rig file's order [C]."""
    hottest: float
    """Highest modelled temperature so far [C]."""
    latest: float
    """Greatest delay of a switching so far [s]."""
    currents: tuple[float, ...] = ()
    """Measured current of each spring, in the rig file's order [A]; NaN where no input measures it, empty
    without a current sensor."""
    voltages: tuple[float, ...] = ()
    """Measured voltage across each spring [V]."""


ReportCallback = Callable[[Report], None]


class HeaterBank(ABC):
    """Springs behind a relay board. Times are on its own clock. `heat` is allowed only while armed."""

    proof: str | None = None
    """What was proven when everything was switched off last."""
    rested_at = 0.0
    """When the springs have rested and cooled from what was heated before they were armed [s]."""

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Arm, and disarm at the end. An exception is an emergency stop. Both prove everything off.

        The exception carries what was proven as a note.
        """
        try:
            self.arm()
            yield
        except BaseException as error:
            self.stop(reason_of(error))
            if self.proof and self.proof not in str(error) and not isinstance(error, NotProvenOffError):
                error.add_note(self.proof)
            raise
        self.disarm()

    @abstractmethod
    def arm(self) -> None:
        """Prove that everything is off, then allow heating. Raises `LatchedError` while a stop is latched."""

    @abstractmethod
    def heat(self, at: float, lengths: Mapping[int, float]) -> None:
        """Announce pulses: these channels close at `at`, and open after so many seconds."""

    @abstractmethod
    def abort_pulses(self) -> None:
        """Open all contacts that heat, and drop the announced pulses. This is no stop."""

    @abstractmethod
    def wait_until(self, t: float, on_report: ReportCallback) -> None:
        """Send heartbeats until `t`, and pass each report to `on_report`."""

    @abstractmethod
    def disarm(self) -> None:
        """The normal end: everything is proven off."""

    @abstractmethod
    def stop(self, why: str) -> None:
        """Emergency stop: everything off, proven, and latched until a reset. A second call does nothing."""


def reason_of(error: BaseException) -> str:
    """Why a run ended, for the latched stop."""
    if isinstance(error, KeyboardInterrupt):
        return "stopped by Ctrl-C"
    if isinstance(error, StoppedError):
        return error.reason
    return str(error) or type(error).__name__
