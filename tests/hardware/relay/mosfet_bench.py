"""The MOSFET board's driver on its emulated board."""

from contextlib import contextmanager

from eldir_hardware.clock import VirtualClock
from eldir_hardware.emulator.mosfet import EmulatedMosfet
from eldir_hardware.relay.mosfet import MosfetBoard
from tests.hardware.rigs_and_schedules import rig_with

RIG = rig_with(board={"kind": "mosfet"})


@contextmanager
def bench(clock=None, channels: int = 4):
    """The emulated board and its driver on its port, in virtual time."""
    clock = clock or VirtualClock()
    emulated = EmulatedMosfet(channels, clock)
    board = MosfetBoard(emulated.start(), channels, clock)
    if isinstance(clock, VirtualClock):
        clock.add_barrier(lambda: emulated.wait_for_bytes(board.bytes_written))
    try:
        yield emulated, board, clock
    finally:
        board.close()
        emulated.close()


def off_at(emulated: EmulatedMosfet, channel: int = 1) -> float:
    return next(e.t for e in emulated.contact_events if e.channel == channel and not e.closed)
