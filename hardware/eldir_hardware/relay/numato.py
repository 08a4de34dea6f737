"""Numato USB relays: words over a virtual serial line; every command is echoed and ends with a prompt.

`relay on 0`, `relay off 0`, `relay writeall 0f`, `relay readall`: channels are counted from 0, masks are
hexadecimal, two digits for up to eight channels and four for more.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from eldir_hardware.clock import Clock
from eldir_hardware.relay.board import MaskBoard
from eldir_hardware.relay.errors import GarbledReplyError
from eldir_hardware.relay.registration import Board

_PROMPT = b">"
_WIDTHS = (1, 2, 4)  # digits of a mask, by the module
_EXTRA = 8  # line ends and the prompt, beyond echo and value
_ECHO = re.compile(rb"(relay (?:on|off|writeall) [0-9a-fA-F]+)\r?\n\r>")


def parse_answer(data: bytes, command: str, min_digits: int = 0) -> str:
    """The hexadecimal digits in an answer: none, or at least `min_digits`. Raises `GarbledReplyError`."""
    value = rb"\n\r([0-9a-fA-F]{%d,16})" % min_digits if min_digits else rb"()"
    match = re.fullmatch(re.escape(command.encode()) + rb"\r?" + value + rb"\n\r>", data)
    if match is None:
        raise GarbledReplyError(
            "the relay board's answer cannot be read",
            expected=f"{command!r} echoed, {min_digits} or more digits and a prompt"
            if min_digits
            else "its echo",
            found=repr(data[:60]),
            remedy="check the board's kind and its number of channels in the rig file; modules that do not "
            "know `relay readall` cannot be used",
        )
    return match[1].decode()


class NumatoBoard(MaskBoard):
    """Numato modules of 1 to 16 channels."""

    reports_per_proof = 2  # without a checksum, one wrong bit could show a closed contact as open

    def __init__(self, url: str, channels: int, clock: Clock):
        super().__init__(url, channels, clock)
        self._digits = 0  # of the module's masks; not known yet

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        if self._uses_mask(changes):
            return super()._frames(changes)
        words = [len("relay on 0" if closed else "relay off 0") for closed in changes.values()]
        return [(length + 1, length + len("\n\r>")) for length in words]

    def _mask_length(self) -> int:
        return len("relay writeall ") + self._width + 1

    def _command(self, channel: int, closed: bool) -> None:
        self._request(f"relay {'on' if closed else 'off'} {channel - 1:X}")

    def _command_mask(self, mask: int) -> None:
        self._request(f"relay writeall {mask:0{self._width}x}")

    def _command_all_off(self) -> None:
        # A mask of the wrong width is harmless: all its digits are 0. The echoes are not read.
        widths = (self._digits,) if self._digits else (self._width, *(w for w in _WIDTHS if w != self._width))
        for width in widths:
            self._line.write(f"relay writeall {0:0{width}x}\r".encode())

    def _report(self) -> tuple[bool, ...]:
        """As many relays as the digits of the module's answer have bits."""
        if not self._digits:
            first, second = (len(self._request_states()) for _ in range(2))
            if first != second:  # a truncated answer would hide relays
                raise GarbledReplyError(
                    "the relay board's answers differ in length",
                    expected=f"{first} digits",
                    found=f"{second} digits",
                )
            self._digits = first
        digits = self._request_states()
        if len(digits) != self._digits:
            raise GarbledReplyError(
                "the relay board's answer has too few digits", expected=f"{self._digits} digits", found=digits
            )
        return _states(digits)

    def _report_once(self) -> tuple[bool, ...]:
        return _states(self._request_states())

    def _request_states(self) -> str:
        return self._request("relay readall", math.ceil(self.channels / 4))

    def _request(self, command: str, min_digits: int = 0) -> str:
        def is_late(data: bytes) -> bool:
            """Whether it answers an earlier command, such as the last one of `all_off`."""
            match = _ECHO.fullmatch(data)
            return match is not None and match[1].decode() != command

        max_length = len(command) + 16 + _EXTRA
        data = self._line.query_until(command.encode() + b"\r", _PROMPT, max_length, is_late)
        return parse_answer(data, command, min_digits)

    def _report_time(self) -> float:
        return self._line.wire_time(2 * len("relay readall") + self._width + _EXTRA)

    @property
    def _width(self) -> int:
        """Digits of the module's masks; before its first report, those of the vendor's larger modules."""
        return self._digits or (2 if self.channels <= 8 else 4)


def _states(digits: str) -> tuple[bool, ...]:
    mask = int(digits, 16)
    return tuple(bool(mask >> i & 1) for i in range(4 * len(digits)))


BOARD = Board(NumatoBoard, "eldir_hardware.emulator.numato:EmulatedNumato")
