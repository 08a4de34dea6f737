"""Boards that report one channel a question, and do not tell how many relays they have."""

from __future__ import annotations

from abc import abstractmethod

from eldir_hardware.clock import Clock
from eldir_hardware.relay.board import RelayBoard


class PerChannelQueryBoard(RelayBoard):
    """Relays beyond `channels` are looked for once; where one answers, all-off must find it open too.

    While heating only the channels in use are asked: each question costs time on the wire.
    """

    def __init__(self, url: str, channels: int, clock: Clock):
        super().__init__(url, channels, clock)
        self._relays = 0  # not known yet

    def _report(self) -> tuple[bool, ...]:
        return tuple(self._ask(channel) for channel in range(1, self.channels + 1))

    def _report_all(self) -> tuple[bool, ...]:
        used = self._report()
        if not self._relays:
            others = self._count_others()
            self._ask(1)  # a line that has died meanwhile proves no relay absent
            self._relays = self.channels + others
        return used + tuple(self._ask(channel) for channel in range(self.channels + 1, self._relays + 1))

    @abstractmethod
    def _ask(self, channel: int) -> bool:
        """Whether the board reports that channel closed."""

    @abstractmethod
    def _count_others(self) -> int:
        """How many relays beyond `channels` answer. Raises `GarbledReplyError` for a gap in the answers."""
