"""A port between a driver and an emulated board on a virtual clock, which damages bytes at given places."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from unittest.mock import patch

from eldir_hardware.clock import VirtualClock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.rig.boards import driver_of, emulator_of


class ImpatientClock(VirtualClock):
    """Waits for an answer as long as the wall clock does, so that an answer can be late."""

    patience = 0.2


@dataclass
class Damage:
    """What happens to the bytes on one way, counted from 0 since `DamagedWire.strike`; -1 is to none."""

    garbled: int = -1
    """One bit of this byte is flipped."""
    bit: int = 5
    """Which one."""
    dropped: int = -1
    """This byte is lost."""
    cut: int = -1
    """This byte and later ones are lost."""
    lost: int = 1 << 30
    """How many are lost then."""
    late_from: int = -1
    late: float = 0.0
    """Delay of that byte and all later ones [s]."""
    count: int = 0

    def pass_on(self, byte: int) -> int | None:
        """The byte that arrives, or None."""
        place, self.count = self.count, self.count + 1
        if place == self.dropped or 0 <= self.cut <= place < self.cut + self.lost:
            return None
        return byte ^ 1 << self.bit if place == self.garbled else byte


class DamagedWire:
    """Has the methods of pyserial's ports, and of their output, that `eldir_hardware.relay.line` uses. Bytes
    arrive at their time."""

    def __init__(self, emulated: EmulatedBoard, clock: VirtualClock):
        self.timeout = 0.0
        self.sent, self.answered = Damage(), Damage()
        self._emulated, self._clock = emulated, clock
        self._pending = b""
        self._coming: deque[tuple[float, int]] = deque()
        emulated._deliver = self._deliver  # type: ignore[method-assign]

    def strike(self, sent: Damage | None = None, answered: Damage | None = None) -> None:
        """Damage what comes from now on: `sent` to the board, `answered` by it. With neither, nothing."""
        self.sent, self.answered = sent or Damage(), answered or Damage()

    def fileno(self) -> int:
        return -1

    def send(self, data: bytes, baud: int, patience: float) -> None:
        heard = bytes(b for b in map(self.sent.pass_on, data) if b is not None)
        self._pending = self._emulated._serve_requests(self._pending + heard)

    def unblock(self) -> None:
        pass

    def close(self) -> None:
        pass

    def reset_input_buffer(self) -> None:
        while self._coming and self._coming[0][0] <= self._clock.now():
            self._coming.popleft()

    def read(self, count: int) -> bytes:
        return self._read(count, b"")

    def read_until(self, end: bytes, most: int) -> bytes:
        return self._read(most, end)

    def _read(self, count: int, end: bytes) -> bytes:
        deadline, found = self._clock.now() + self.timeout, bytearray()
        while len(found) < count and not (end and found.endswith(end)):
            if not self._coming or self._coming[0][0] > deadline:
                self._clock.sleep_until(deadline)
                break
            arrival, byte = self._coming.popleft()
            self._clock.sleep_until(arrival)
            found.append(byte)
        return bytes(found)

    def _deliver(self, answer: bytes) -> None:
        for byte in answer:
            late = self.answered.late if 0 <= self.answered.late_from <= self.answered.count else 0.0
            arrived = self.answered.pass_on(byte)
            if arrived is not None:
                self._coming.append((self._emulated._wire_free_at + late, arrived))


def wired(kind: str, channels: int, relays: int) -> tuple[EmulatedBoard, RelayBoard, DamagedWire]:
    """A board of so many relays, the driver of a rig file of so many channels, and the wire between them.

    All on one virtual clock. Raises `InputError` for a kind that is not installed.
    """
    clock = ImpatientClock()
    emulated = emulator_of(kind)(relays, clock)
    wire = DamagedWire(emulated, clock)
    with (
        patch("serial.serial_for_url", lambda *_, **__: wire),
        patch("eldir_hardware.relay.line.SerialOutput", lambda handle: wire),
    ):
        return emulated, driver_of(kind)("wire", channels, clock), wire
