"""Relay drivers and emulated boards on one virtual clock, with the bytes between them."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from eldir_hardware.clock import VirtualClock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.emulator.mosfet import EmulatedMosfet
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.rig.boards import driver_of, emulator_of


class Powered(NamedTuple):
    """A board that is switched on, and its driver."""

    clock: VirtualClock
    emulated: EmulatedBoard
    board: RelayBoard
    requests: list[bytes]
    """What the board has obeyed."""
    spoilt: list[str]
    """What becomes of the next answers: sound, silent, garbled; sound when none is left."""


@contextmanager
def powered(kind: str, channels: int = 4, relays: int | None = None) -> Iterator[Powered]:
    """A board of an installed kind, switched on, with its driver, on a virtual clock.

    `relays`: those that the board has, if the driver is told another number. Raises `InputError` for a kind
    that is not installed.
    """
    clock = VirtualClock()
    clock.patience = 0.05  # an answer that is not coming costs real time
    emulated = emulator_of(kind)(relays or channels, clock)
    requests: list[bytes] = []
    spoilt: list[str] = []
    obey, pass_on = emulated._obey, emulated._answer

    def heard(request: bytes) -> bytes:
        requests.append(request)
        return obey(request)

    def answered(answer: bytes) -> None:
        how = spoilt.pop(0) if spoilt else "sound"
        if how != "silent":
            pass_on(bytes(b ^ 0x20 for b in answer) if how == "garbled" else answer)

    emulated._obey, emulated._answer = heard, answered  # type: ignore[method-assign]
    board = driver_of(kind)(emulated.start(), channels, clock)
    clock.before_moving(lambda: emulated.wait_for_bytes(board.bytes_written))
    try:
        yield Powered(clock, emulated, board, requests, spoilt)
    finally:
        board.close()
        emulated.close()


def close_contacts(emulated: EmulatedBoard, channels: Iterable[int]) -> None:
    """Close contacts without a command of the driver. The limits of a board that has some are loosened, as
    it would open them by itself."""
    if isinstance(emulated, EmulatedMosfet):
        limits = emulated.limits
        limits.acknowledge()
        limits.heartbeat_ms, limits.steady = 1 << 29, [True] * emulated.channels
        for channel in channels:
            limits.switch(channel - 1, 100, 0)
        emulated._follow(emulated._clock.now())
        return
    for channel in channels:
        emulated._set_coil(channel, True)


def pass_time(p: Powered, seconds: float) -> None:
    """Let time pass; a board that opens everything when it hears nothing is asked for its state meanwhile."""
    until = p.clock.now() + seconds
    while p.clock.now() + p.board.patience / 2 < until:
        p.clock.sleep_until(p.clock.now() + p.board.patience / 2)
        p.board.states()
    p.clock.sleep_until(until)
