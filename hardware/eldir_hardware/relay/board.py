"""The interface of all relay boards; a driver adds only the bytes of its protocol."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import NamedTuple

from eldir.core.arguments import require_value
from eldir_hardware.clock import Clock
from eldir_hardware.relay.errors import (
    BlockedPortError,
    ContactError,
    GarbledReplyError,
    NotProvenOffError,
    RelayError,
    SilentBoardError,
)
from eldir_hardware.relay.line import SerialLine

_ATTEMPTS = 2  # to read a garbled report; after silence there is no second attempt
_TIMEOUT_MARGIN = 0.1  # an answer that takes this much longer was a timeout [s]
_OFF_ATTEMPTS = 4
CONTACT_TIME = 0.010
"""Time from switching a relay's coil to the movement of its contact [s]."""


class RunRequirements(NamedTuple):
    """What a run requires of a board."""

    max_on_s: float
    """The longest pulse [s]."""
    duty: float
    """Largest part of the time for which a channel heats."""
    heating: frozenset[int]
    """Channels that heat."""
    steady: frozenset[int]
    """Channels without a limit of their time, such as a fan's."""


class RelayBoard(ABC):
    """Channels 1 to N, as printed on the board. Owns its line and closes it."""

    baud = 9600
    settling = 0.1
    """Time from a command until the board reports the new state [s]."""
    command_length = 4
    """Bytes of a command for one channel."""
    answer_length = 0
    """Bytes of its answer; the next command waits for them."""
    closing_interval = 0.0
    """Time between the closing of two contacts, on a board that opens both with one frame [s]."""
    contact_time = CONTACT_TIME
    """Time from the end of a command until its contact moves [s]."""
    times_pulses = False
    """Whether the board itself opens a channel after a given time, even if this computer fails."""
    max_relays = 0
    """Relays that `all_off` opens one by one, even if the rig file has fewer channels."""
    reports_per_proof = 1
    """Number of reports that must show every contact open; more than one if they have no checksum."""
    retriggerable: bool | None = None
    """Whether a second pulse restarts the timer; None if the protocol does not say: it is measured then."""
    patience = float("inf")
    """Time without a request after which the board opens every contact by itself [s]."""
    fails_closed = False
    """Whether its switches fail closed together, so that none of them can cut off another."""

    def __init__(self, url: str | SerialLine, channels: int, clock: Clock):
        self.channels = channels
        self._line = url if isinstance(url, SerialLine) else SerialLine(url, self.baud, clock)
        self._clock = clock
        self._report_valid_at = clock.now()
        self._commanded: dict[int, bool] = {}
        self.before_closing: Callable[[], None] = _permit
        """Called before each frame that closes a contact; it raises to prevent that."""

    @property
    def bytes_written(self) -> int:
        """Bytes written to the line since it was opened."""
        return self._line.bytes_written

    @property
    def file_descriptor(self) -> int:
        """File descriptor of its port."""
        return self._line.file_descriptor

    @property
    def report_valid_at(self) -> float:
        """When the board reports the latest command [s on the clock]."""
        return self._report_valid_at

    def switching_delay(self, changes: Mapping[int, bool]) -> float:
        """Time from sending these commands until their contacts move [s].

        If each command has its own frame, this is the mean of the first and the last contact.
        """
        received, before = [], 0
        for command, answer in self._frames(changes):
            received.append(before + command)
            before += command + answer
        return self._line.wire_time(received[0] + received[-1]) / 2 + self.contact_time

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
            require_value("relay channel", 1 <= channel <= self.channels, f"1 to {self.channels}", channel)
        if any(changes.values()):
            self.before_closing()
        changed = any(self._commanded.get(c) is not closed for c, closed in changes.items())
        pulses = {c: at_most[c] for c, closed in changes.items() if closed and at_most and c in at_most}
        self._command_timed({c: closed for c, closed in changes.items() if c not in pulses}, pulses)
        self._commanded |= changes
        if changed:  # repeating a command moves nothing
            self._report_valid_at = max(self._clock.now(), self._line.sent_at) + self.settling

    def read_states(self, attempts: int = _ATTEMPTS) -> tuple[bool, ...]:
        """Whether the board reports each channel closed, channel 1 first. A garbled report is read again,
        unless it ended with a timeout.

        Raises `ContactError` if the report shows a closed relay beyond `channels`.
        """
        for attempt in range(attempts):
            asked_at = self._clock.now()
            try:
                return self._select_used(self._report())
            except GarbledReplyError:
                waited_out = self._clock.now() - asked_at > self.report_time + _TIMEOUT_MARGIN
                if attempt == attempts - 1 or waited_out:
                    raise
        raise AssertionError("unreachable")

    def reports_all_open(self) -> bool:
        """Whether one report shows every contact open; for use after another program has proven it."""
        try:
            return not any(self._report_once())
        except RelayError:
            return False

    def verify(self, attempts: int = _ATTEMPTS) -> tuple[bool, ...]:
        """Wait until the report is valid, and compare it with the commands. Raises `RelayError`."""
        self._clock.sleep_until(self._report_valid_at)
        reported = self.read_states(attempts)
        self._compare(reported)
        return reported

    def _compare(self, reported: tuple[bool, ...]) -> None:
        for channel, wanted in self._commanded.items():
            if reported[channel - 1] is not wanted:
                raise ContactError(
                    f"relay channel {channel} did not switch",
                    expected=_describe_state(wanted),
                    found=_describe_state(not wanted),
                    remedy="cut the heating supply, then look at the board and its kind in the rig file",
                )

    def _select_used(self, reported: tuple[bool, ...]) -> tuple[bool, ...]:
        """The states of the channels in use. Raises `ContactError` if another relay is closed."""
        for number, closed in enumerate(reported[self.channels :], start=self.channels + 1):
            if closed:
                raise ContactError(
                    f"contact {number} is closed, but the rig file has {self.channels} channels",
                    expected="open",
                    found="closed",
                    remedy="cut the heating supply, then correct board.channels or look at the board",
                )
        return reported[: self.channels]

    def switch(self, changes: Mapping[int, bool]) -> tuple[bool, ...]:
        """`send`, then `verify`."""
        self.send(changes)
        return self.verify()

    def all_off(self) -> None:
        """Open every contact that the board has, and prove it by read-back.

        All commands are sent before any answer is read; only the read-back counts. Raises `NotProvenOffError`
        after several attempts.
        """
        for attempt in range(_OFF_ATTEMPTS):
            try:
                self._line.unblock()
                self._command_all_off()
                self._commanded = dict.fromkeys(range(1, self.channels + 1), False)
                self._report_valid_at = max(self._clock.now(), self._line.sent_at) + self.settling
                self._clock.sleep_until(self._report_valid_at)
                for _ in range(self.reports_per_proof):
                    self._compare(self._select_used(self._report_all()))
                return
            except RelayError as error:
                stays_blocked = attempt > 0 and isinstance(error, BlockedPortError)
                if attempt == _OFF_ATTEMPTS - 1 or stays_blocked:
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

    def check_limits(self, requirements: RunRequirements) -> None:  # noqa: B027 # most boards have none
        """Compare a run with the board's own limits. Raises `InputError` if the run might exceed them."""

    def close(self) -> None:
        """Close the port; contacts stay as they are."""
        self._line.close()

    @abstractmethod
    def _command(self, channel: int, closed: bool) -> None:
        """Send the command for one channel."""

    @abstractmethod
    def _report(self) -> tuple[bool, ...]:
        """Query the states of all channels, and of the other relays in the same report."""

    def _report_once(self) -> tuple[bool, ...]:
        """A single report, without first determining the number of relays."""
        return self._report()

    def _report_all(self) -> tuple[bool, ...]:
        """The report of every relay of the board; override it if `_report` queries only those in use."""
        return self._report()

    @abstractmethod
    def _report_time(self) -> float:
        """Wire time of the query and its answer [s]."""

    def _pulse(self, channel: int, seconds: float) -> None:
        """Close one channel for `seconds`; a board without a timer is commanded later to open it."""
        self._command(channel, True)

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        """Lengths of each command that `send` writes for these changes, and of its answer [bytes]."""
        return [(self.command_length, self.answer_length)] * len(changes)

    def _command_timed(self, changes: Mapping[int, bool], pulses: Mapping[int, float]) -> None:
        """Switch channels, then close those in `pulses` for their times [s]."""
        if changes:
            self._command_many(changes)
        for channel, seconds in pulses.items():
            self.before_closing()
            self._pulse(channel, seconds)

    def _command_many(self, changes: Mapping[int, bool]) -> None:
        """Switch several channels, in one frame if the protocol allows it."""
        for channel, closed in changes.items():
            if closed:
                self.before_closing()
            self._command(channel, closed)

    def _command_all_off(self) -> None:
        """Open every relay of the board.

        A driver whose commands are answered should write all frames without waiting for answers.
        """
        for channel in range(1, max(self.channels, self.max_relays) + 1):
            with suppress(SilentBoardError, GarbledReplyError):  # the read-back decides
                self._command(channel, False)


class MaskBoard(RelayBoard):
    """A board that sets all channels with one mask; a channel whose bit is 0 is switched off."""

    def _uses_mask(self, changes: Mapping[int, bool]) -> bool:
        known = self._commanded.keys() | changes.keys()
        return len(changes) > 1 and len(known) == self.channels

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        return [(self._mask_length(), 0)] if self._uses_mask(changes) else super()._frames(changes)

    def _command_many(self, changes: Mapping[int, bool]) -> None:
        if not self._uses_mask(changes):
            super()._command_many(changes)
            return
        after = self._commanded | dict(changes)
        self._command_mask(sum(1 << channel - 1 for channel, closed in after.items() if closed))

    @abstractmethod
    def _mask_length(self) -> int:
        """Bytes of the command with the mask."""

    @abstractmethod
    def _command_mask(self, mask: int) -> None:
        """Close the channels whose bits are set, channel 1 lowest, and open all others."""


def _permit() -> None:
    """The default: every contact may close."""


def _describe_state(closed: bool) -> str:
    return "closed" if closed else "open"
