"""LCUS boards: CH340 and the "A0" protocol in dialect A.

Command: A0, channel, 01 on or 00 off, checksum; never acknowledged, no address for all channels.
Report: FF is answered by ten characters a channel. The report is stale for about 50 ms, so the
interface's settling time of 100 ms stands. Contacts keep their state when the port closes.
"""

from __future__ import annotations

import re

from eldir_hardware.clock import Clock
from eldir_hardware.relay.a0 import a0_frame
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import GarbledReplyError, TooManyRelaysError
from eldir_hardware.relay.registration import Board

_QUERY = b"\xff"
_LINE_LENGTH = 10
_MAX_RELAYS = 8
_LINE = re.compile(rb"CH([1-8]): (ON |OFF)\r\n")


def parse_report(data: bytes, channels: int) -> tuple[bool, ...]:
    """The states in one whole report, channel 1 first: at least so many. Raises `GarbledReplyError`."""
    states = []
    for i in range(len(data) // _LINE_LENGTH):
        match = _LINE.fullmatch(data[i * _LINE_LENGTH : (i + 1) * _LINE_LENGTH])
        if match is None or int(match[1]) != i + 1:
            break
        states.append(match[2] == b"ON ")
    if len(states) < channels or len(data) != len(states) * _LINE_LENGTH:
        raise GarbledReplyError(
            "the relay board's report cannot be read",
            expected=f"{channels} or more lines such as 'CH1: OFF'",
            found=repr(data[:40]),
            remedy="check the board's kind and its number of channels in the rig file",
        )
    return tuple(states)


class LcusBoard(RelayBoard):
    """LCUS-1, -2, -4 and -8. The length of a report shows how many relays the board has."""

    max_relays = _MAX_RELAYS

    def __init__(self, url: str, channels: int, clock: Clock):
        super().__init__(url, channels, clock)
        self._relays = 0  # not known yet

    def _command(self, channel: int, closed: bool) -> None:
        self._line.write(a0_frame(channel, int(closed)))

    def _report(self) -> tuple[bool, ...]:
        if self._relays:
            return parse_report(self._line.query(_QUERY, self._relays * _LINE_LENGTH), self._relays)
        # Two reports determine the number of relays, as a truncated one would hide some of them.
        first, second = self._report_once(), self._report_once()
        if len(first) != len(second):
            raise GarbledReplyError(
                "the relay board's reports differ in length",
                expected=f"{len(first)} channels",
                found=str(len(second)),
            )
        self._relays = len(second)
        return second

    def _report_once(self) -> tuple[bool, ...]:
        min_length, max_length = (n * _LINE_LENGTH for n in (self.channels, _MAX_RELAYS))
        report = self._line.query_until_idle(_QUERY, min_length, max_length)
        if len(report) > max_length and _LINE.match(report):
            raise TooManyRelaysError(_MAX_RELAYS, f"{report[max_length:]!r} after them")
        return parse_report(report, self.channels)

    def _report_time(self) -> float:
        return self._line.wire_time(len(_QUERY) + (self._relays or self.channels) * _LINE_LENGTH)


BOARD = Board(LcusBoard, "eldir_hardware.emulator.a0:EmulatedLcus", max_channels=_MAX_RELAYS)
