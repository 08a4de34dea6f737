"""SainSmart's 16-channel board: Modbus ASCII, unit FE.

A frame is a colon, hexadecimal bytes, their checksum (LRC: all bytes of a frame add up to 0) and a
line's end. Every request is answered, one that switches a single coil by its echo.

The vendor's table of frames has wrong checksums for three frames of channels 15 and 16, and an answer
to `read coils` of an odd length. This driver follows the standard; it was not tried on a board.
"""

from __future__ import annotations

from eldir_hardware.relay.board import MaskBoard
from eldir_hardware.relay.errors import GarbledReplyError
from eldir_hardware.relay.registration import Board

_UNIT = 0xFE
_READ_COILS, _WRITE_COIL, _WRITE_COILS = 0x01, 0x05, 0x0F
_COILS = 16
_ALL = bytes((_WRITE_COILS, 0, 0, 0, _COILS))
_END = b"\n"
_MAX_ANSWER = 32  # characters of any answer
_MASK_LENGTH = 23  # characters of a command for all coils
_REPORT_LENGTH = 17 + 15  # characters of a query and its answer


def ascii_request(*body: int) -> bytes:
    """Function and data of a request as characters."""
    data = bytes((_UNIT, *body))
    return b":" + (data + bytes((-sum(data) & 0xFF,))).hex().upper().encode() + b"\r\n"


def parse_ascii_answer(data: bytes, head: bytes, length: int) -> bytes:
    """The bytes after `head` in an answer of `length` bytes, without checksum. Raises `GarbledReplyError`."""
    problem = GarbledReplyError(
        "the relay board's answer cannot be read",
        expected=f": {_UNIT:02X} {head.hex(' ').upper()} ..., {length} bytes with a valid checksum",
        found=repr(data[:60]),
        remedy=f"check the board's kind in the rig file, and that the board is set to unit {_UNIT:02X}",
    )
    if data[:1] != b":" or data[-2:] != b"\r\n" or len(data) != 2 * length + 3:
        raise problem
    digits = data[1:-2]
    if not all(d in b"0123456789ABCDEF" for d in digits):
        raise problem
    values = bytes.fromhex(digits.decode())
    if sum(values) & 0xFF or values[0] != _UNIT or values[1 : 1 + len(head)] != head:
        raise problem
    return values[1 + len(head) : -1]


def parse_ascii_coils(data: bytes, channels: int) -> tuple[bool, ...]:
    """The states in an answer to `read coils`, channel 1 first."""
    low, high = parse_ascii_answer(data, bytes((_READ_COILS, _COILS // 8)), 6)
    return tuple(bool((low | high << 8) >> i & 1) for i in range(channels))


class SainSmartBoard(MaskBoard):
    """A board of 16 coils; the first `channels` of them are used."""

    command_length = answer_length = 17

    def _mask_length(self) -> int:
        return _MASK_LENGTH

    def _command(self, channel: int, closed: bool) -> None:
        request = ascii_request(_WRITE_COIL, 0, channel - 1, 0xFF if closed else 0, 0)
        answer = self._line.query_until(request, _END, _MAX_ANSWER)
        if answer != request:
            raise GarbledReplyError(
                "the relay board did not confirm a command", expected=repr(request), found=repr(answer)
            )

    def _command_all_off(self) -> None:
        self._line.write(_all_coils(0))  # its answer is not read

    def _command_mask(self, mask: int) -> None:
        request = _all_coils(mask)
        answer = self._line.query_until(request, _END, _MAX_ANSWER)
        if answer != request:  # public drivers expect the whole frame back, the standard its first half
            parse_ascii_answer(answer, _ALL, 7)

    def _report(self) -> tuple[bool, ...]:
        answer = self._line.query_until(ascii_request(_READ_COILS, 0, 0, 0, _COILS), _END, _MAX_ANSWER)
        return parse_ascii_coils(answer, _COILS)

    def _report_time(self) -> float:
        return self._line.wire_time(_REPORT_LENGTH)


def _all_coils(mask: int) -> bytes:
    return ascii_request(*_ALL, 2, *mask.to_bytes(2, "little"))


BOARD = Board(SainSmartBoard, "eldir_hardware.emulator.sainsmart:EmulatedSainSmart")
