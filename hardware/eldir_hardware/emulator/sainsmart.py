"""An emulated SainSmart 16-channel board (Modbus ASCII), written from the standard and its page."""

from __future__ import annotations

from eldir_hardware.emulator.board import EmulatedBoard

_RELAYS = 16


class EmulatedSainSmart(EmulatedBoard):
    """Obeys functions 1, 5 and 15 as unit 254; of its 16 coils the first `channels` have a relay.

    It is not known whether the real board answers function 15 by the standard or by an echo: `echoes_writes`
    selects it.
    """

    echoes_writes = False

    def request_length(self, data: bytes) -> int:
        if data and data[:1] != b":":
            return 1
        return data.find(b"\n") + 1

    def obey(self, request: bytes) -> bytes:
        text = request.decode("latin-1")
        try:
            numbers = [int(text[i : i + 2], 16) for i in range(1, len(text) - 2, 2)]
        except ValueError:
            return b""
        if len(numbers) < 7 or not text.endswith("\r\n") or sum(numbers) % 256 or numbers[0] != 254:
            return b""
        first, value = numbers[2] * 256 + numbers[3], numbers[4] * 256 + numbers[5]
        match numbers[1]:
            case 1 if first == 0 and value == _RELAYS:
                states = self.coils + [False] * (_RELAYS - self.channels)
                mask = sum(2**i for i in range(_RELAYS) if states[i])
                return self._line(254, 1, 2, mask % 256, mask // 256)
            case 5 if first < _RELAYS and value in (0, 65280):
                self.set_coil(first + 1, value > 0)
                return request
            case 15 if first == 0 and value == _RELAYS and len(numbers) == 10:
                for i in range(_RELAYS):
                    self.set_coil(i + 1, bool(numbers[7 + i // 8] & 2 ** (i % 8)))
                return request if self.echoes_writes else self._line(254, 15, 0, 0, 0, _RELAYS)
        return self._line(254, numbers[1] | 128, 2)

    @staticmethod
    def _line(*numbers: int) -> bytes:
        checksum = (256 - sum(numbers) % 256) % 256
        return (":" + "".join(f"{n:02X}" for n in (*numbers, checksum)) + "\r\n").encode("ascii")
