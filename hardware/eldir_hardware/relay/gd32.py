"""GD32 boards with a CH340: the "A0" protocol in dialect C, at 115200 baud.

Command: A0, channel, 00 open, 01 close or 02 query, checksum; channel 0F is all of them. Only the
query is answered, by `CH1:ON` or `CH1:OFF` and a line's end.
"""

from __future__ import annotations

from collections.abc import Mapping

from eldir_hardware.relay.a0 import FRAME_LENGTH, PerChannelQueryBoard, a0_frame
from eldir_hardware.relay.errors import GarbledReplyError, TooManyRelaysError
from eldir_hardware.relay.registration import Board

_ALL, _QUERY = 0x0F, 0x02
_MAX_RELAYS = 14  # channel 15 addresses all relays
_UNUSED_NUMBER = 16
_MAX_ANSWER = 10  # CH16:OFF and the line's end


def parse_line(data: bytes, channel: int) -> bool:
    """Whether that channel is closed, from its one line. Raises `GarbledReplyError`."""
    for closed, word in ((True, "ON"), (False, "OFF")):
        if data == f"CH{channel}:{word}\r\n".encode():
            return closed
    raise GarbledReplyError(
        "the relay board's report cannot be read",
        expected=f"CH{channel}:ON or CH{channel}:OFF",
        found=repr(data[:40]),
        remedy="check the board's kind in the rig file",
    )


class Gd32Board(PerChannelQueryBoard):
    """A GD32 board; it needs one query for each channel."""

    baud = 115200

    def _command(self, channel: int, closed: bool) -> None:
        self._line.write(a0_frame(channel, int(closed)))

    def _command_all_off(self) -> None:
        self._line.write(a0_frame(_ALL, 0))

    def _is_uniform(self, changes: Mapping[int, bool]) -> bool:
        return len(changes) == self.channels and len(set(changes.values())) == 1

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        return super()._frames(changes)[: 1 if self._is_uniform(changes) else None]

    def _command_many(self, changes: Mapping[int, bool]) -> None:
        if self._is_uniform(changes):
            self._line.write(a0_frame(_ALL, int(changes[1])))
        else:
            super()._command_many(changes)

    def _query(self, channel: int) -> bool:
        return parse_line(self._line.query_until(a0_frame(channel, _QUERY), b"\n", _MAX_ANSWER), channel)

    def _count_unused(self) -> int:
        unused = [*range(self.channels + 1, _MAX_RELAYS + 1), _UNUSED_NUMBER]
        lines = self._line.query_each([a0_frame(c, _QUERY) for c in unused], _MAX_ANSWER).splitlines(
            keepends=True
        )
        for channel, line in zip(unused, lines, strict=False):
            parse_line(line, channel)
        if len(lines) == len(unused):
            raise TooManyRelaysError(_MAX_RELAYS, f"an answer of number {_UNUSED_NUMBER}: {lines[-1]!r}")
        return len(lines)

    def _report_time(self) -> float:
        return self._line.wire_time((FRAME_LENGTH + _MAX_ANSWER) * self.channels)


BOARD = Board(Gd32Board, "eldir_hardware.emulator.a0:EmulatedGd32", max_channels=_MAX_RELAYS)
