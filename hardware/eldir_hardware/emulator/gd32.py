"""An emulated GD32 board (A0 protocol, dialect C), written from its page."""

from __future__ import annotations

from eldir_hardware.emulator.board import EmulatedBoard


class EmulatedGd32(EmulatedBoard):
    """0 switches off, 1 on, 2 asks; relay 15 means every relay."""

    baud = 115200

    def _request_length(self, data: bytes) -> int:
        if data and data[0] != 160:
            return 1
        if len(data) < 4:
            return 0
        return 4 if (data[0] + data[1] + data[2]) % 256 == data[3] else 1

    def _obey(self, request: bytes) -> bytes:
        if len(request) < 4 or request[2] > 2:
            return b""
        relays = list(range(1, self.channels + 1)) if request[1] == 15 else [request[1]]
        if request[2] == 2:
            known = [n for n in relays if 1 <= n <= self.channels]
            lines = [f"CH{n}:ON\r\n" if self._coils[n - 1] else f"CH{n}:OFF\r\n" for n in known]
            return "".join(lines).encode("ascii")
        for n in relays:
            self._set_coil(n, request[2] == 1)
        return b""
