"""Boards of the "A0" protocol in dialect B, which acknowledge commands: `feedback`.

Command: A0, channel, operation, checksum; 02 opens, 03 closes, 05 queries, each answered by A0, channel,
state, checksum. In dialect C the operation 02 is the query: never mix up the two.
"""

from __future__ import annotations

from eldir_hardware.relay.a0 import FRAME_LENGTH, PerChannelQueryBoard, a0_frame
from eldir_hardware.relay.errors import GarbledReplyError, TooManyRelaysError
from eldir_hardware.relay.registration import Board

_OPEN, _CLOSE, _QUERY = 0x02, 0x03, 0x05
_MAX_RELAYS = 16


def parse_state(data: bytes, channel: int) -> bool:
    """Whether that channel is closed, from one whole answer. Raises `GarbledReplyError`."""
    for closed in (False, True):
        if data == a0_frame(channel, int(closed)):
            return closed
    raise GarbledReplyError(
        "the relay board's answer cannot be read",
        expected=f"{a0_frame(channel, 0).hex(' ')} or {a0_frame(channel, 1).hex(' ')}",
        found=data[:40].hex(" "),
        remedy="check the board's kind in the rig file",
    )


class FeedbackBoard(PerChannelQueryBoard):
    """Each frame switches one channel, and the board answers with the new state."""

    answer_length = FRAME_LENGTH

    def _command(self, channel: int, closed: bool) -> None:
        # The answer proves only that the board is connected: states are read back after settling.
        parse_state(self._line.query(a0_frame(channel, _CLOSE if closed else _OPEN), FRAME_LENGTH), channel)

    def _command_all_off(self) -> None:
        for channel in range(1, _MAX_RELAYS + 1):
            written_at = self._clock.now()
            self._line.write(a0_frame(channel, _OPEN))
            answers = not self._relays or channel <= self._relays  # which are not read
            self._clock.sleep_until(written_at + self._line.wire_time((1 + answers) * FRAME_LENGTH))

    def _query(self, channel: int) -> bool:
        return parse_state(self._line.query(a0_frame(channel, _QUERY), FRAME_LENGTH), channel)

    def _count_unused(self) -> int:
        unused = range(self.channels + 1, _MAX_RELAYS + 2)  # one more than any board has
        answers = self._line.query_each([a0_frame(channel, _QUERY) for channel in unused], FRAME_LENGTH)
        for i in range(0, len(answers), FRAME_LENGTH):
            parse_state(answers[i : i + FRAME_LENGTH], unused[i // FRAME_LENGTH])
        count = len(answers) // FRAME_LENGTH
        if count == len(unused):
            raise TooManyRelaysError(
                _MAX_RELAYS, f"an answer of number {_MAX_RELAYS + 1}: {answers[-FRAME_LENGTH:].hex(' ')}"
            )
        return count

    def _report_time(self) -> float:
        return self._line.wire_time(2 * FRAME_LENGTH * self.channels)


BOARD = Board(FeedbackBoard, "eldir_hardware.emulator.a0:EmulatedFeedback", max_channels=_MAX_RELAYS)
