"""The interface of all relay boards; a driver adds only the bytes of its protocol."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from eldir.errors import InputError
from hardware.clock import Clock
from hardware.relay.errors import (
    ContactError,
    GarbledReplyError,
    NotProvenOffError,
    RelayError,
)
from hardware.relay.line import SerialLine

_ATTEMPTS = 2  # at a garbled report; silence is waited out once
_OFF_ATTEMPTS = 4
CONTACT_TIME = 0.010
"""Time from switching a relay's coil to the movement of its contact [s]."""


class RelayBoard(ABC):
    """Channels 1 to N, as printed on the board. Owns its line and closes it."""

    baud = 9600
    settling = 0.1
    """Time from a command until the board's report is valid [s]."""
    command_length = 4
    """Bytes of a command for one channel."""
    answer_length = 0
    """Bytes of its answer; the next command waits for them."""
    closing_apart = 0.0
    """Time between the closing of two contacts that would open in one frame [s]."""
    times_pulses = False
    """Whether the board opens a channel by itself after a given time, even if this computer dies."""

    def __init__(self, url: str, channels: int, clock: Clock):
        self.channels = channels
        self._line = SerialLine(url, self.baud, clock)
        self._clock = clock
        self._settled_at = clock.now()
        self._wanted: dict[int, bool] = {}

    @property
    def bytes_written(self) -> int:
        """Bytes written to the line since it was opened."""
        return self._line.bytes_written

    @property
    def settled_at(self) -> float:
        """When the report becomes valid [s on the clock]."""
        return self._settled_at

    def delay(self, changes: Mapping[int, bool]) -> float:
        """Time from sending these commands until their contacts move [s].

        If each command has its own frame: the middle between the first and the last contact.
        """
        heard, before = [], 0
        for command, answer in self._frames(changes):
            heard.append(before + command)
            before += command + answer
        return self._line.wire_time(heard[0] + heard[-1]) / 2 + CONTACT_TIME

    @property
    def report_time(self) -> float:
        """Duration of a read-back [s]."""
        return self._report_time()

    def send(self, changes: Mapping[int, bool], at_most: Mapping[int, float] | None = None) -> None:
        """Close (True) or open (False) channels without waiting; call `verify` later.

        `at_most` [s]: a board that times pulses opens these channels by itself after this time.
        Raises `InputError` for a channel that the board does not have.
        """
        for channel in changes:
            if not 1 <= channel <= self.channels:
                raise InputError(
                    "no such relay channel", expected=f"1 to {self.channels}", found=str(channel)
                )
        changed = any(self._wanted.get(c) is not closed for c, closed in changes.items())
        pulses = {c: at_most[c] for c, closed in changes.items() if closed and at_most and c in at_most}
        if others := {c: closed for c, closed in changes.items() if c not in pulses}:
            self._command_many(others)
        for channel, seconds in pulses.items():
            self._pulse(channel, seconds)
        self._wanted |= changes
        if changed:  # repeating a command moves nothing
            self._settled_at = self._clock.now() + self.settling

    def states(self, attempts: int = _ATTEMPTS) -> tuple[bool, ...]:
        """Whether the board reports each channel closed, channel 1 first; a garbled report is retried."""
        for attempt in range(attempts):
            try:
                return self._report()
            except GarbledReplyError:
                if attempt == attempts - 1:
                    raise
        raise AssertionError("unreachable")

    def verify(self, attempts: int = _ATTEMPTS) -> tuple[bool, ...]:
        """Wait until the report is valid, and compare it with the commands. Raises `RelayError`."""
        self._clock.sleep_until(self._settled_at)
        reported = self.states(attempts)
        for channel, wanted in self._wanted.items():
            if reported[channel - 1] is not wanted:
                raise ContactError(
                    f"relay channel {channel} does not follow",
                    expected=_word(wanted),
                    found=_word(not wanted),
                    remedy="cut the heating supply, then look at the board and its kind in the rig file",
                )
        return reported

    def switch(self, changes: Mapping[int, bool]) -> tuple[bool, ...]:
        """`send`, then `verify`."""
        self.send(changes)
        return self.verify()

    def all_off(self) -> None:
        """Open every contact and prove it by read-back. Raises `NotProvenOffError` after several attempts."""
        for attempt in range(_OFF_ATTEMPTS):
            try:
                self._command_all_off()
                self._wanted = dict.fromkeys(range(1, self.channels + 1), False)
                self._settled_at = self._clock.now() + self.settling
                self.verify(attempts=1)
                return
            except RelayError as error:
                if attempt == _OFF_ATTEMPTS - 1:
                    raise NotProvenOffError(
                        f"not proven that everything is off: {error}", remedy="cut the heating supply now"
                    ) from None

    @contextmanager
    def armed(self) -> Iterator[RelayBoard]:
        """Verify that everything is off, at the start and at the end, also after an exception."""
        self.all_off()
        try:
            yield self
        finally:
            self.all_off()

    def close(self) -> None:
        """Close the port; contacts stay as they are."""
        self._line.close()

    @abstractmethod
    def _command(self, channel: int, closed: bool) -> None:
        """Send the command for one channel."""

    @abstractmethod
    def _report(self) -> tuple[bool, ...]:
        """Ask for and parse the report of all channels."""

    @abstractmethod
    def _report_time(self) -> float:
        """Wire time of the query and its answer [s]."""

    def _pulse(self, channel: int, seconds: float) -> None:
        """Close one channel for so long; a board without a timer is commanded to open it later."""
        self._command(channel, True)

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        """Bytes of each command that `send` writes for these, and of the answer that it waits for."""
        return [(self.command_length, self.answer_length)] * len(changes)

    def _command_many(self, changes: Mapping[int, bool]) -> None:
        """Switch several channels, in one frame if the protocol allows it."""
        for channel, closed in changes.items():
            self._command(channel, closed)

    def _command_all_off(self) -> None:
        """Open every channel. A driver that waits for answers must still command all channels."""
        failed: RelayError | None = None
        for channel in range(1, self.channels + 1):
            try:
                self._command(channel, False)
            except RelayError as error:
                failed = failed or error
        if failed is not None:
            raise failed


class MaskBoard(RelayBoard):
    """A board that sets all channels with one mask, which switches off every channel that it leaves out."""

    def _masked(self, changes: Mapping[int, bool]) -> bool:
        known = self._wanted.keys() | changes.keys()
        return len(changes) > 1 and len(known) == self.channels

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        return [(self._mask_length(), 0)] if self._masked(changes) else super()._frames(changes)

    def _command_many(self, changes: Mapping[int, bool]) -> None:
        if not self._masked(changes):
            super()._command_many(changes)
            return
        after = self._wanted | dict(changes)
        self._command_mask(sum(1 << channel - 1 for channel, closed in after.items() if closed))

    def _command_all_off(self) -> None:
        self._command_mask(0)

    @abstractmethod
    def _mask_length(self) -> int:
        """Bytes of the command with the mask."""

    @abstractmethod
    def _command_mask(self, mask: int) -> None:
        """Close the channels whose bits are set, channel 1 lowest, and open all others."""


def _word(closed: bool) -> str:
    return "closed" if closed else "open"
