"""An emulated board of the A0 protocol's dialect B, written from the protocol's description."""

from __future__ import annotations

from eldir_hardware.emulator.board import EmulatedBoard


class EmulatedFeedback(EmulatedBoard):
    """Answers 2 (off), 3 (on), 4 (toggle) and 5 (query) with the relay's state; ignores all else."""

    def _request_length(self, data: bytes) -> int:
        if data and data[0] != 160:
            return 1
        if len(data) < 4:
            return 0
        sound = sum(data[:3]) % 256 == data[3] and 2 <= data[2] <= 5 and 1 <= data[1] <= self.channels
        return 4 if sound else 1

    def _obey(self, request: bytes) -> bytes:
        if len(request) < 4:
            return b""
        _, relay, verb, _ = request
        if verb != 5:
            self._set_coil(relay, verb == 3 or (verb == 4 and not self._coils[relay - 1]))
        state = 1 if self._coils[relay - 1] else 0
        return bytes([160, relay, state, (160 + relay + state) % 256])
