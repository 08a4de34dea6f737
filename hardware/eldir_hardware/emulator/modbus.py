"""An emulated Waveshare Modbus RTU relay board, written from its manual, not from the driver."""

from __future__ import annotations

import struct
from collections.abc import Callable

from eldir_hardware.clock import Clock
from eldir_hardware.emulator.board import ContactEvent, EmulatedBoard

_TABLE = []
for _byte in range(256):
    _value = _byte
    for _ in range(8):
        _value = _value >> 1 ^ (40961 if _value % 2 else 0)
    _TABLE.append(_value)


def _crc(data: bytes) -> int:
    value = 65535
    for byte in data:
        value = value >> 8 ^ _TABLE[(value ^ byte) % 256]
    return value


class EmulatedModbus(EmulatedBoard):
    """Reads and writes coils, one or all, and flashes them on and off by its own timers.

    It is not known whether a second flash restarts the timer of the real board: `retriggerable` selects it;
    nor whether a query for too many coils gets an exception or no answer: `answers_exceptions` selects it.
    """

    answers_exceptions = True

    def __init__(
        self, channels: int, clock: Clock, on_contact_event: Callable[[ContactEvent], None] | None = None
    ):
        super().__init__(channels, clock, on_contact_event)
        self.retriggerable = True
        self._flashes = [0] * channels  # number of the latest flash of each relay
        self._flashing = [False] * channels

    def request_length(self, data: bytes) -> int:
        if len(data) < 8:
            return 0 if not data or data[0] == 1 else 1
        valid = data[0] == 1 and struct.unpack("<H", data[6:8])[0] == _crc(data[:6])
        return 8 if valid else 1

    def obey(self, request: bytes) -> bytes:
        if len(request) < 8:
            return b""
        _, function, register, value = struct.unpack(">BBHH", request[:6])
        if function == 1 and register == 0 and 0 < value <= 8 * ((self.channels + 7) // 8):
            return self._with_crc(bytes((1, 1, (value + 7) // 8)) + self._bits(value))
        if function == 5 and self._write(register, value):
            return request
        return (
            self._with_crc(bytes((1, function | 128, 2))) if self.answers_exceptions or function != 1 else b""
        )

    def _write(self, register: int, value: int) -> bool:
        kind, number = divmod(register, 256)
        if kind in (2, 4) and number < self.channels and 0 < value <= 32767:
            self._flash(number, kind == 2, value / 10)
            return True
        if kind != 0 or value not in (0, 65280):
            return False
        if number == 255:
            for channel in range(1, self.channels + 1):
                self.set_coil(channel, value == 65280)
        elif number < self.channels:
            self.set_coil(number + 1, value == 65280)
        else:
            return False
        return True

    def _flash(self, number: int, on: bool, seconds: float) -> None:
        if self._flashing[number] and not self.retriggerable:
            return
        self._flashing[number] = True
        self._flashes[number] += 1
        number_of_this = self._flashes[number]

        def end(t: float) -> None:
            if self._flashes[number] == number_of_this:
                self._flashing[number] = False
                self.set_coil(number + 1, not on, t)

        self.set_coil(number + 1, on)
        self._clock.call_at(self._wire_free_at + seconds, end)

    def _bits(self, count: int) -> bytes:
        mask = sum(1 << i for i, coil in enumerate(self.coils[:count]) if coil)
        return mask.to_bytes((count + 7) // 8, "little")

    @staticmethod
    def _with_crc(body: bytes) -> bytes:
        return body + struct.pack("<H", _crc(body))
