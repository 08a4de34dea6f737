"""Numato USB relays: words over a virtual serial line; every command is echoed and ends with a prompt.

`relay on 0`, `relay off 0`, `relay writeall 0f`, `relay readall`: channels are counted from 0, masks are
hexadecimal, two digits for up to eight channels and four for more.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from hardware.relay.board import MaskBoard
from hardware.relay.errors import GarbledReplyError
from hardware.relay.registration import Board

_PROMPT = b">"
_EXTRA = 8  # line ends and the prompt, beyond echo and value


def parse_answer(data: bytes, command: str, digits: int) -> int:
    """The value of so many hexadecimal digits in an answer, 0 without digits. Raises `GarbledReplyError`."""
    value = rb"\n\r([0-9a-fA-F]{%d})" % digits if digits else rb"()"
    match = re.fullmatch(re.escape(command.encode()) + rb"\r?" + value + rb"\n\r>", data)
    if match is None:
        raise GarbledReplyError(
            "the relay board's answer cannot be read",
            expected=f"{command!r} echoed, {digits} digits and a prompt",
            found=repr(data[:60]),
            remedy="check the board's kind and its number of channels in the rig file",
        )
    return int(match[1] or b"0", 16)


class NumatoBoard(MaskBoard):
    """Numato modules of 1 to 16 channels."""

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        if self._masked(changes):
            return super()._frames(changes)
        words = [len("relay on 0" if closed else "relay off 0") for closed in changes.values()]
        return [(length + 1, length + len("\n\r>")) for length in words]

    def _mask_length(self) -> int:
        return len("relay writeall ") + self._digits + 1

    def _command(self, channel: int, closed: bool) -> None:
        self._say(f"relay {'on' if closed else 'off'} {channel - 1:X}")

    def _command_mask(self, mask: int) -> None:
        self._say(f"relay writeall {mask:0{self._digits}x}")

    def _report(self) -> tuple[bool, ...]:
        mask = self._say("relay readall", self._digits)
        if mask >> self.channels:
            raise GarbledReplyError(
                "the relay board reports channels that it does not have",
                expected=f"{self.channels} channels",
                found=f"{mask:x}",
                remedy="check its number of channels in the rig file",
            )
        return tuple(bool(mask >> i & 1) for i in range(self.channels))

    def _say(self, command: str, digits: int = 0) -> int:
        most = len(command) + digits + _EXTRA
        return parse_answer(self._line.ask_until(command.encode() + b"\r", _PROMPT, most), command, digits)

    def _report_time(self) -> float:
        return self._line.wire_time(2 * len("relay readall") + self._digits + _EXTRA)

    @property
    def _digits(self) -> int:
        return 2 if self.channels <= 8 else 4


BOARD = Board(NumatoBoard, "hardware.emulator.numato:EmulatedNumato")
