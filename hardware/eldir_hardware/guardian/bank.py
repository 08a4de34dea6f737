"""Interface to heat springs, its reports, and which run may heat."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

from eldir.errors import DISK_FULL
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.safety.stop_signals import StoppedError

BOARD_PROOF = "all contacts are open by the board's report"
LEAD = 0.3
"""Pulses are announced at least this long before they begin, so that they begin on time [s]."""
PATIENCE = 0.6
"""A commander counts as lost after this time without a command [s]."""


class Report(NamedTuple):
    """The read-back of the board and the modelled temperatures at one instant."""

    t: float
    """Time on the bank's clock [s]."""
    closed: tuple[bool, ...]
    """Whether each channel is closed, channel 1 first."""
    temperatures: tuple[float, ...]
    """Modelled temperature of each spring, in the rig file's order [C]."""
    peak: float
    """Highest modelled temperature so far [C]."""
    max_delay: float
    """Longest delay of a switching so far [s]."""
    currents: tuple[float, ...] = ()
    """Measured current of each spring, in the rig file's order [A]; NaN where no input measures it, empty
    without a current sensor."""
    voltages: tuple[float, ...] = ()
    """Measured voltage across each spring [V]."""


ReportCallback = Callable[[Report], None]


def ignore_report(report: Report) -> None:
    """The default: ignore reports."""


class HeaterBank(ABC):
    """Heated springs behind a relay board. Times are on its own clock. `heat` is allowed only while armed."""

    proof: str | None = None
    """What was proven when everything was last switched off."""
    ready_at = 0.0
    """When the springs have cooled and rested from the previous run [s]."""

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Arm, and disarm at the end; an exception causes an emergency stop. Both prove everything off.

        A note of the exception says what was proven.
        """
        try:
            self.arm()
            yield
        except BaseException as error:
            self.stop(describe_reason(error))
            if self.proof and self.proof not in str(error) and not isinstance(error, NotProvenOffError):
                error.add_note(self.proof)
            raise
        self.disarm()

    @abstractmethod
    def arm(self) -> None:
        """Prove that everything is off, then allow heating. Raises `LatchedError` while a stop is latched."""

    @abstractmethod
    def heat(self, at: float, durations: Mapping[int, float]) -> None:
        """Announce pulses: channels close at `at` [s on the clock], each for its duration [s]."""

    @abstractmethod
    def abort_pulses(self) -> None:
        """Open all contacts that heat, and cancel the announced pulses, without a latched stop."""

    @abstractmethod
    def wait_until(self, t: float, on_report: ReportCallback = ignore_report) -> None:
        """Send keepalive messages until `t`, and pass each report to `on_report`."""

    @abstractmethod
    def disarm(self) -> None:
        """End normally: everything is switched off and proven off."""

    @abstractmethod
    def stop(self, reason: str) -> None:
        """Emergency stop: everything is switched off, proven off, and latched until a reset."""


def describe_reason(error: BaseException) -> str:
    """The reason of a run's end, for the latched stop."""
    if isinstance(error, KeyboardInterrupt):
        return "stopped by Ctrl-C"
    if isinstance(error, StoppedError):
        return error.reason
    if isinstance(error, OSError) and error.errno in DISK_FULL:
        return f"cannot write: {error}"
    return str(error) or type(error).__name__


class Commander:
    """Admits one run at a time, which must repeat its commands. Times are on a monotonic clock [s]."""

    def __init__(self, patience: float = PATIENCE):
        self.name = ""
        """Name of the run that heats; empty if none does."""
        self._patience = patience
        self._last_command = 0.0

    def accepts(self, name: str) -> bool:
        """Whether a command of this run may be obeyed, as no other run heats."""
        return self.name in ("", name)

    def record_command(self, name: str, now: float) -> None:
        """Record a command of a run that heats."""
        self.name, self._last_command = name, now

    def release(self) -> None:
        """Record that no run heats any more."""
        self.name = ""

    def silence_if_lost(self, now: float) -> float | None:
        """Time without a command of the run that heats [s], if it is too long; None otherwise."""
        silent = now - self._last_command
        return silent if self.name and silent > self._patience else None
