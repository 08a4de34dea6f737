"""Emulated boards of the A0 protocol (LCUS, feedback, GD32), from data sheets, not from the drivers."""

from __future__ import annotations

from eldir_hardware.emulator.board import EmulatedBoard


class EmulatedLcus(EmulatedBoard):
    """Obeys valid frames without an answer, skips noise, and answers FF with a line for each channel."""

    def request_length(self, data: bytes) -> int:
        if not data or data[0] != 160:
            return len(data[:1])  # a query, or noise
        if len(data) < 4:
            return 0
        return 4 if sum(data[:3]) % 256 == data[3] and data[2] < 2 else 1

    def obey(self, request: bytes) -> bytes:
        if request == b"\xff":
            return self._status().encode()
        if len(request) == 4:
            self.set_coil(request[1], on=request[2] == 1)
        return b""

    def _status(self) -> str:
        words = {True: "ON ", False: "OFF"}
        return "".join(f"CH{i}: {words[coil]}\r\n" for i, coil in enumerate(self.coils, start=1))


class EmulatedFeedback(EmulatedBoard):
    """Answers 2 (off), 3 (on), 4 (toggle) and 5 (query) with the relay's state; ignores all else."""

    def request_length(self, data: bytes) -> int:
        if data and data[0] != 160:
            return 1
        if len(data) < 4:
            return 0
        sound = sum(data[:3]) % 256 == data[3] and 2 <= data[2] <= 5 and 1 <= data[1] <= self.channels
        return 4 if sound else 1

    def obey(self, request: bytes) -> bytes:
        if len(request) < 4:
            return b""
        _, relay, verb, _ = request
        if verb != 5:
            self.set_coil(relay, verb == 3 or (verb == 4 and not self.coils[relay - 1]))
        state = 1 if self.coils[relay - 1] else 0
        return bytes([160, relay, state, (160 + relay + state) % 256])


class EmulatedGd32(EmulatedBoard):
    """0 switches off, 1 on, 2 asks; relay 15 means every relay."""

    baud = 115200

    def request_length(self, data: bytes) -> int:
        if data and data[0] != 160:
            return 1
        if len(data) < 4:
            return 0
        return 4 if (data[0] + data[1] + data[2]) % 256 == data[3] else 1

    def obey(self, request: bytes) -> bytes:
        if len(request) < 4 or request[2] > 2:
            return b""
        relays = list(range(1, self.channels + 1)) if request[1] == 15 else [request[1]]
        if request[2] == 2:
            known = [n for n in relays if 1 <= n <= self.channels]
            lines = [f"CH{n}:ON\r\n" if self.coils[n - 1] else f"CH{n}:OFF\r\n" for n in known]
            return "".join(lines).encode("ascii")
        for n in relays:
            self.set_coil(n, request[2] == 1)
        return b""
