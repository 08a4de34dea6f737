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

_ATTEMPTS = 2  # at a garbled report; silence is waited out once
_SHORT_WAIT = 0.1  # an answer that takes this much longer has no end [s]
_OFF_ATTEMPTS = 4
CONTACT_TIME = 0.010
"""Time from switching a relay's coil to the movement of its contact [s]."""


class RunRequirements(NamedTuple):
    """What a run asks of a board."""

    longest_on: float
    """The longest pulse [s]."""
    duty: float
    """Largest part of the time for which a channel heats."""
    heating: frozenset[int]
    """Channels that heat."""
    steady: frozenset[int]
    """Channels that may be closed for as long as something else needs them, such as a fan's."""


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
    contact_time = CONTACT_TIME
    """Time from the end of a command until its contact moves [s]."""
    times_pulses = False
    """Whether the board opens a channel by itself after a given time, even if this computer dies."""
    most_relays = 0
    """Relays that all-off commands one by one, also where the rig file says fewer channels."""
    reports_in_a_proof = 1
    """Reports that must all say that everything is off. More than one where no checksum protects them."""
    retriggerable: bool | None = None
    """Whether a second pulse restarts the timer, where the protocol says so; else it must be measured."""
    patience = float("inf")
    """Time without a command or a question after which the board opens everything by itself [s]."""
    fails_closed = False
    """Whether its switches fail closed together, so that none of them can be another one's cut-off."""

    def __init__(self, url: str | SerialLine, channels: int, clock: Clock):
        self.channels = channels
        self._line = url if isinstance(url, SerialLine) else SerialLine(url, self.baud, clock)
        self._clock = clock
        self._settled_at = clock.now()
        self._wanted: dict[int, bool] = {}
        self.before_closing: Callable[[], None] = _allow
        """Called before each frame that closes a contact; it raises where none may close any more."""

    @property
    def bytes_written(self) -> int:
        """Bytes written to the line since it was opened."""
        return self._line.bytes_written

    @property
    def handle(self) -> int:
        """The open file of its port."""
        return self._line.handle

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
        return self._line.wire_time(heard[0] + heard[-1]) / 2 + self.contact_time

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
        changed = any(self._wanted.get(c) is not closed for c, closed in changes.items())
        pulses = {c: at_most[c] for c, closed in changes.items() if closed and at_most and c in at_most}
        self._command_timed({c: closed for c, closed in changes.items() if c not in pulses}, pulses)
        self._wanted |= changes
        if changed:  # repeating a command moves nothing
            self._settled_at = max(self._clock.now(), self._line.sent_at) + self.settling

    def states(self, attempts: int = _ATTEMPTS) -> tuple[bool, ...]:
        """Whether the board reports each channel closed, channel 1 first; a garbled report is retried, unless
        its end had to be waited for, as with silence.

        Raises `ContactError` if the same report shows a closed relay beyond `channels`.
        """
        for attempt in range(attempts):
            asked_at = self._clock.now()
            try:
                return self._own(self._report())
            except GarbledReplyError:
                waited_out = self._clock.now() - asked_at > self.report_time + _SHORT_WAIT
                if attempt == attempts - 1 or waited_out:
                    raise
        raise AssertionError("unreachable")

    def reports_all_open(self) -> bool:
        """Whether one report says so: a second look, where another program has just proven everything off."""
        try:
            return not any(self._glance())
        except RelayError:
            return False

    def verify(self, attempts: int = _ATTEMPTS) -> tuple[bool, ...]:
        """Wait until the report is valid, and compare it with the commands. Raises `RelayError`."""
        self._clock.sleep_until(self._settled_at)
        reported = self.states(attempts)
        self._compare(reported)
        return reported

    def _compare(self, reported: tuple[bool, ...]) -> None:
        for channel, wanted in self._wanted.items():
            if reported[channel - 1] is not wanted:
                raise ContactError(
                    f"relay channel {channel} does not follow",
                    expected=_word(wanted),
                    found=_word(not wanted),
                    remedy="cut the heating supply, then look at the board and its kind in the rig file",
                )

    def _own(self, reported: tuple[bool, ...]) -> tuple[bool, ...]:
        """The report of the channels in use. No other relay of the board may be closed."""
        for number, closed in enumerate(reported[self.channels :], start=self.channels + 1):
            if closed:
                raise ContactError(
                    f"contact {number} is closed; the rig file says {self.channels} channels",
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

        All commands go out before any answer is read; only the read-back counts. Raises `NotProvenOffError`
        after several attempts.
        """
        for attempt in range(_OFF_ATTEMPTS):
            try:
                self._line.unblock()
                self._command_all_off()
                self._wanted = dict.fromkeys(range(1, self.channels + 1), False)
                self._settled_at = max(self._clock.now(), self._line.sent_at) + self.settling
                self._clock.sleep_until(self._settled_at)
                for _ in range(self.reports_in_a_proof):
                    self._compare(self._own(self._report_all()))
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

    def check_limits(self, terms: RunRequirements) -> None:  # noqa: B027 # most boards have no limits
        """Ask a board that has limits of its own. Raises `InputError` where a run might exceed them."""

    def close(self) -> None:
        """Close the port; contacts stay as they are."""
        self._line.close()

    @abstractmethod
    def _command(self, channel: int, closed: bool) -> None:
        """Send the command for one channel."""

    @abstractmethod
    def _report(self) -> tuple[bool, ...]:
        """Ask for and parse the report of all channels, and of the other relays that it shows as well."""

    def _glance(self) -> tuple[bool, ...]:
        """A single report, without finding out first how many relays there are."""
        return self._report()

    def _report_all(self) -> tuple[bool, ...]:
        """The report of every relay that the board has, where `_report` asks for those in use alone."""
        return self._report()

    @abstractmethod
    def _report_time(self) -> float:
        """Wire time of the query and its answer [s]."""

    def _pulse(self, channel: int, seconds: float) -> None:
        """Close one channel for so long; a board without a timer is commanded to open it later."""
        self._command(channel, True)

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        """Bytes of each command that `send` writes for these, and of the answer that it waits for."""
        return [(self.command_length, self.answer_length)] * len(changes)

    def _command_timed(self, changes: Mapping[int, bool], pulses: Mapping[int, float]) -> None:
        """Switch channels, then close those of `pulses` for so many seconds."""
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

        A driver whose commands are answered should write all frames without waiting: here a lost answer
        delays the next command.
        """
        for channel in range(1, max(self.channels, self.most_relays) + 1):
            with suppress(SilentBoardError, GarbledReplyError):  # the read-back tells
                self._command(channel, False)


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

    @abstractmethod
    def _mask_length(self) -> int:
        """Bytes of the command with the mask."""

    @abstractmethod
    def _command_mask(self, mask: int) -> None:
        """Close the channels whose bits are set, channel 1 lowest, and open all others."""


def _allow() -> None:
    """The default: any contact may close."""


def _word(closed: bool) -> str:
    return "closed" if closed else "open"
