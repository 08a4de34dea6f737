"""The driver and the emulator of the board that a rig file names."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pkgutil import resolve_name

from eldir.errors import InputError
from hardware.clock import Clock, WallClock
from hardware.emulator.board import EmulatedBoard
from hardware.relay.board import RelayBoard
from hardware.relay.registration import board_of
from hardware.rig.configuration import Rig


def driver_of(kind: str) -> type[RelayBoard]:
    """The class that drives boards of a kind."""
    return board_of(kind).driver


def emulator_of(kind: str) -> type[EmulatedBoard]:
    """The class that emulates boards of a kind."""
    name = board_of(kind).emulator
    try:
        found: type[EmulatedBoard] = resolve_name(name)
    except (Exception, SystemExit) as error:  # another package's code runs here
        raise InputError(
            f"the emulator of relay board {kind} cannot be loaded from {name}",
            found=f"{type(error).__name__}: {error}",
            remedy="repair the package that provides this board",
        ) from None
    return found


@contextmanager
def open_board(rig: Rig, clock: Clock | None = None, port: str | None = None) -> Iterator[RelayBoard]:
    """The board of a rig, at another port where one is given. Closing it leaves the contacts as they are."""
    url = port or rig.board.port
    if url is None:
        raise InputError("the rig file names no port", remedy="set board.port")
    board = driver_of(rig.board.kind)(url, rig.board.channels, clock or WallClock())
    try:
        yield board
    finally:
        board.close()
