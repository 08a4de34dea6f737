"""Boards of the "A0" protocol in dialect B, which acknowledge commands: `feedback`.

Command: A0, channel, operation, checksum; 02 opens, 03 closes, 05 asks, each answered by A0, channel,
state, checksum. On boards of dialect C the operation 02 asks: the two must never be mixed up.
"""

from __future__ import annotations

from eldir_hardware.relay.a0 import FRAME_LENGTH, a0_frame
from eldir_hardware.relay.errors import GarbledReplyError, TooManyRelaysError
from eldir_hardware.relay.per_channel_query import PerChannelQueryBoard
from eldir_hardware.relay.registration import Board

_OPEN, _CLOSE, _ASK = 0x02, 0x03, 0x05
_MOST = 16


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
    """One channel a frame. The board answers a command with the new state."""

    answer_length = FRAME_LENGTH

    def _command(self, channel: int, closed: bool) -> None:
        # Its answer counts only as proof that the board is there: states are read back after settling.
        parse_state(self._line.ask(a0_frame(channel, _CLOSE if closed else _OPEN), FRAME_LENGTH), channel)

    def _command_all_off(self) -> None:
        for channel in range(1, _MOST + 1):
            written_at = self._clock.now()
            self._line.write(a0_frame(channel, _OPEN))
            answers = not self._relays or channel <= self._relays  # which pass by
            self._clock.sleep_until(written_at + self._line.wire_time((1 + answers) * FRAME_LENGTH))

    def _ask(self, channel: int) -> bool:
        return parse_state(self._line.ask(a0_frame(channel, _ASK), FRAME_LENGTH), channel)

    def _count_others(self) -> int:
        others = range(self.channels + 1, _MOST + 2)  # one more than there can be
        answers = self._line.ask_each([a0_frame(channel, _ASK) for channel in others], FRAME_LENGTH)
        for i in range(0, len(answers), FRAME_LENGTH):
            parse_state(answers[i : i + FRAME_LENGTH], others[i // FRAME_LENGTH])
        count = len(answers) // FRAME_LENGTH
        if count == len(others):
            raise TooManyRelaysError(
                _MOST, f"an answer of number {_MOST + 1}: {answers[-FRAME_LENGTH:].hex(' ')}"
            )
        return count

    def _report_time(self) -> float:
        return self._line.wire_time(2 * FRAME_LENGTH * self.channels)


BOARD = Board(FeedbackBoard, "eldir_hardware.emulator.feedback:EmulatedFeedback", most_channels=_MOST)
