"""The "A0" protocol: the frame that its dialects share, and boards with one query per channel."""

from __future__ import annotations

from abc import abstractmethod

from eldir_hardware.clock import Clock
from eldir_hardware.relay.board import RelayBoard

_HEAD = 0xA0
FRAME_LENGTH = 4


def a0_frame(channel: int, value: int) -> bytes:
    """A0, channel, an operation or a state, and their checksum."""
    body = (_HEAD, channel, value)
    return bytes((*body, sum(body) & 0xFF))


class PerChannelQueryBoard(RelayBoard):
    """A board that reports one channel per query, and not the number of its relays.

    Relays beyond `channels` are queried once; `all_off` proves those that answer open, too. While heating
    only the channels in use are queried, as each query takes time on the wire.
    """

    def __init__(self, url: str, channels: int, clock: Clock):
        super().__init__(url, channels, clock)
        self._relays = 0  # not known yet

    def _report(self) -> tuple[bool, ...]:
        return tuple(self._query(channel) for channel in range(1, self.channels + 1))

    def _report_all(self) -> tuple[bool, ...]:
        used = self._report()
        if not self._relays:
            others = self._count_unused()
            self._query(1)  # silence of a lost line does not mean that there are no other relays
            self._relays = self.channels + others
        return used + tuple(self._query(channel) for channel in range(self.channels + 1, self._relays + 1))

    @abstractmethod
    def _query(self, channel: int) -> bool:
        """Whether the board reports that channel closed."""

    @abstractmethod
    def _count_unused(self) -> int:
        """Number of relays beyond `channels` that answer. Raises `GarbledReplyError` for a gap among them."""
