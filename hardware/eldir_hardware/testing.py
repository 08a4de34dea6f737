"""Test doubles for authors of relay boards: emulated boards, their faults, damaged bytes, time.

Public, with a page: docs/reference/test-doubles.md. No other module of eldir imports this one. The virtual
camera is in `eldir_hardware.vision`, the virtual rig in `eldir_hardware.virtual`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple
from unittest.mock import patch

from eldir_hardware.clock import VirtualClock
from eldir_hardware.emulator.board import ContactEvent, EmulatedBoard, Faults
from eldir_hardware.emulator.mosfet import EmulatedMosfet
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.rig.devices import get_driver, get_emulator

__all__ = [
    "ContactEvent",
    "Damage",
    "DamagedWire",
    "EmulatedBoard",
    "Faults",
    "Powered",
    "VirtualClock",
    "close_contacts",
    "get_driver",
    "get_emulator",
    "pass_time",
    "powered",
    "wired",
]


class Powered(NamedTuple):
    """A board under power, and its driver."""

    clock: VirtualClock
    emulated: EmulatedBoard
    board: RelayBoard
    requests: list[bytes]
    """Requests that the board has obeyed."""
    answer_faults: list[str]
    """Faults of the next answers: valid, silent or garbled; valid after the last one."""


@contextmanager
def powered(kind: str, channels: int = 4, relays: int | None = None) -> Iterator[Powered]:
    """A board of an installed kind, switched on, with its driver, on a virtual clock.

    `relays`: number of relays of the board, if the driver gets another number. Raises `InputError` for a kind
    that is not installed.
    """
    clock = VirtualClock()
    clock.patience = 0.05  # an answer that is not coming costs real time
    emulated = get_emulator(kind)(relays or channels, clock)
    requests: list[bytes] = []
    answer_faults: list[str] = []
    obey, pass_on = emulated.obey, emulated.send_answer

    def received(request: bytes) -> bytes:
        requests.append(request)
        return obey(request)

    def answered(answer: bytes) -> None:
        fault = answer_faults.pop(0) if answer_faults else "valid"
        if fault != "silent":
            pass_on(bytes(b ^ 0x20 for b in answer) if fault == "garbled" else answer)

    emulated.obey, emulated.send_answer = received, answered  # type: ignore[method-assign]
    board = get_driver(kind)(emulated.start(), channels, clock)
    clock.add_barrier(lambda: emulated.wait_for_bytes(board.bytes_written))
    try:
        yield Powered(clock, emulated, board, requests, answer_faults)
    finally:
        board.close()
        emulated.close()


def close_contacts(emulated: EmulatedBoard, channels: Iterable[int]) -> None:
    """Close contacts without a command of the driver. The limits of a board that has some are disabled, as
    it would open the contacts."""
    if isinstance(emulated, EmulatedMosfet):
        limits = emulated.limits
        limits.acknowledge()
        limits.heartbeat_ms, limits.steady = 1 << 29, [True] * emulated.channels
        for channel in channels:
            limits.switch(channel - 1, 100, 0)
        emulated._move_gates(emulated._clock.now())
        return
    for channel in channels:
        emulated.set_coil(channel, True)


def pass_time(p: Powered, seconds: float) -> None:
    """Let time pass; the states are read so often that no heartbeat limit opens contacts."""
    until = p.clock.now() + seconds
    while p.clock.now() + p.board.patience / 2 < until:
        p.clock.sleep_until(p.clock.now() + p.board.patience / 2)
        p.board.read_states()
    p.clock.sleep_until(until)


class ImpatientClock(VirtualClock):
    """Waits for an answer as long as a wall clock, so that an answer can be too late."""

    patience = 0.2


@dataclass
class Damage:
    """Damage to the bytes of one direction, counted from 0 since `DamagedWire.strike`; -1 means none."""

    garbled: int = -1
    """One bit of this byte is flipped."""
    bit: int = 5
    """Number of that bit."""
    dropped: int = -1
    """This byte is lost."""
    cut: int = -1
    """This byte and later ones are lost."""
    lost: int = 1 << 30
    """Number of bytes that are lost."""
    late_from: int = -1
    late: float = 0.0
    """Delay of that byte and all later ones [s]."""
    count: int = 0

    def pass_on(self, byte: int) -> int | None:
        """The byte that arrives; None if it is lost."""
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
        emulated.deliver = self._deliver  # type: ignore[method-assign]

    def strike(self, sent: Damage | None = None, answered: Damage | None = None) -> None:
        """Damage the following bytes: `sent` to the board, `answered` by it. Without arguments, none."""
        self.sent, self.answered = sent or Damage(), answered or Damage()

    def fileno(self) -> int:
        return -1

    def send(self, data: bytes, baud: int, patience: float) -> None:
        received = bytes(b for b in map(self.sent.pass_on, data) if b is not None)
        self._pending = self._emulated._serve_requests(self._pending + received)

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
    """A board with `relays` relays, a driver for `channels` channels, and the wire between them.

    All on one virtual clock. Raises `InputError` for a kind that is not installed.
    """
    clock = ImpatientClock()
    emulated = get_emulator(kind)(relays, clock)
    wire = DamagedWire(emulated, clock)
    with (
        patch("serial.serial_for_url", lambda *_, **__: wire),
        patch("eldir_hardware.relay.line.SerialOutput", lambda handle: wire),
    ):
        return emulated, get_driver(kind)("wire", channels, clock), wire
