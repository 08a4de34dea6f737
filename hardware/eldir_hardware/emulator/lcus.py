"""An emulated LCUS board (A0 protocol, dialect A), written from its data sheet, not from the driver."""

from __future__ import annotations

from eldir_hardware.emulator.board import EmulatedBoard


class EmulatedLcus(EmulatedBoard):
    """Obeys valid frames without an answer, skips noise, and answers FF with a line for each channel."""

    def _request_length(self, data: bytes) -> int:
        if not data or data[0] != 160:
            return len(data[:1])  # a query, or noise
        if len(data) < 4:
            return 0
        return 4 if sum(data[:3]) % 256 == data[3] and data[2] < 2 else 1

    def _obey(self, request: bytes) -> bytes:
        if request == b"\xff":
            return self._status().encode()
        if len(request) == 4:
            self._set_coil(request[1], on=request[2] == 1)
        return b""

    def _status(self) -> str:
        words = {True: "ON ", False: "OFF"}
        return "".join(f"CH{i}: {words[coil]}\r\n" for i, coil in enumerate(self._coils, start=1))
