"""Modbus RTU relay boards (Waveshare), unit 1: pulses are timed by the board itself.

Every request is answered, a switching one by its echo. A pulse ("flash on") opens by the board's own
timer in steps of 100 ms, also when this computer has died meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from eldir_hardware._serial_output import BITS_PER_BYTE
from eldir_hardware.clock import Clock
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import GarbledReplyError, SilentBoardError, TooManyRelaysError
from eldir_hardware.relay.registration import Board

_UNIT = 1
_READ_COILS, _WRITE_COIL = 0x01, 0x05
_ON, _OFF, _ALL, _FLASH_ON = 0xFF00, 0x0000, 0x00FF, 0x0200
_FLASH_STEP = 0.1  # [s]
_FRAME_LENGTH = 8
_MAX_COILS = 32  # coils that are queried


def rtu_checksum(data: bytes) -> bytes:
    """CRC-16 of Modbus, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return crc.to_bytes(2, "little")


def rtu_request(function: int, address: int, value: int) -> bytes:
    """A request; all requests have the same length."""
    body = bytes((_UNIT, function)) + address.to_bytes(2, "big") + value.to_bytes(2, "big")
    return body + rtu_checksum(body)


_NO_SUCH_COIL = b"\x01\x81\x02" + rtu_checksum(b"\x01\x81\x02")
"""Answer to a query for more coils than the board has: exception 2."""


def parse_rtu_coils(data: bytes, channels: int) -> tuple[bool, ...]:
    """The states in an answer to `read coils`, channel 1 first. Raises `GarbledReplyError`."""
    count = math.ceil(channels / 8)
    head = bytes((_UNIT, _READ_COILS, count))
    if len(data) != count + 5 or data[:3] != head or rtu_checksum(data[:-2]) != data[-2:]:
        raise GarbledReplyError(
            "the relay board's answer cannot be read",
            expected=f"{count + 5} bytes from {head.hex(' ')} to a valid checksum",
            found=data[:40].hex(" "),
            remedy="check the board's kind and its number of channels in the rig file, and that it is set to "
            f"unit {_UNIT} and {RelayBoard.baud} baud",
        )
    return tuple(bool(data[3 + i // 8] >> i % 8 & 1) for i in range(channels))


class ModbusBoard(RelayBoard):
    """Waveshare Modbus RTU Relay."""

    settling = 0.05
    times_pulses = True
    command_length = answer_length = _FRAME_LENGTH
    closing_interval = 2 * _FRAME_LENGTH * BITS_PER_BYTE / RelayBoard.baud

    def __init__(self, url: str, channels: int, clock: Clock):
        super().__init__(url, channels, clock)
        self._coils = 0  # not known yet

    def _command(self, channel: int, closed: bool) -> None:
        self._write(channel - 1, _ON if closed else _OFF)

    def _pulse(self, channel: int, seconds: float) -> None:
        self._write(_FLASH_ON + channel - 1, math.ceil(seconds / _FLASH_STEP - 1e-6))

    def _opens_all(self, changes: Mapping[int, bool]) -> bool:
        # One frame for several coils (0F) might stop the timers of those that stay closed.
        return len(changes) > 1 and not any((self._commanded | dict(changes)).values())

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        opening = {c: closed for c, closed in changes.items() if not closed}
        alone = len(changes) - len(opening) + (1 if self._opens_all(opening) else len(opening))
        return [(self.command_length, self.answer_length)] * alone

    def _command_many(self, changes: Mapping[int, bool]) -> None:
        if self._opens_all(changes):
            self._write(_ALL, _OFF)
        else:
            super()._command_many(changes)

    def _command_all_off(self) -> None:
        self._line.write(rtu_request(_WRITE_COIL, _ALL, _OFF))  # its echo is not read

    def _write(self, address: int, value: int) -> None:
        request = rtu_request(_WRITE_COIL, address, value)
        answer = self._line.query(request, _FRAME_LENGTH)
        if answer != request:
            raise GarbledReplyError(
                "the relay board did not confirm a command", expected=request.hex(" "), found=answer.hex(" ")
            )

    def _report(self) -> tuple[bool, ...]:
        coils = self._coils or self._count_coils()
        states = self._read(coils)
        self._coils = coils  # kept only if the board still answers after the counting
        return states

    def _read(self, coils: int) -> tuple[bool, ...]:
        answer = self._line.query(rtu_request(_READ_COILS, 0, coils), _report_length(coils))
        return parse_rtu_coils(answer, coils)

    def _count_coils(self) -> int:
        """The largest number of coils, a multiple of eight, that the board reports."""
        coils = _coils_for(self.channels)
        self._read(coils)
        while self._has_coils(coils + 8):
            coils += 8
            if coils > _MAX_COILS:
                raise TooManyRelaysError(_MAX_COILS, f"states of {coils}")
        return coils

    def _has_coils(self, coils: int) -> bool:
        request, length = rtu_request(_READ_COILS, 0, coils), _report_length(coils)
        for _ in range(2):  # a lost answer must not hide relays
            try:
                answer = self._line.query_until_idle(request, 1, length)
            except SilentBoardError:
                continue
            if answer == _NO_SUCH_COIL:
                return False
            parse_rtu_coils(answer, coils)
            return True
        return False

    def _report_time(self) -> float:
        return self._line.wire_time(_FRAME_LENGTH + _report_length(self._coils or _coils_for(self.channels)))


def _coils_for(channels: int) -> int:
    """Coils are read in multiples of eight: some boards answer nothing else."""
    return 8 * math.ceil(channels / 8)


def _report_length(coils: int) -> int:
    return 5 + math.ceil(coils / 8)


BOARD = Board(ModbusBoard, "eldir_hardware.emulator.modbus:EmulatedModbus")
