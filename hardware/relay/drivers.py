"""Which driver speaks to which kind of board."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from eldir.errors import InputError
from hardware.clock import Clock, WallClock
from hardware.relay.board import RelayBoard
from hardware.relay.feedback import FeedbackBoard
from hardware.relay.gd32 import Gd32Board
from hardware.relay.lcus import LcusBoard
from hardware.relay.modbus import ModbusBoard
from hardware.relay.numato import NumatoBoard
from hardware.relay.sainsmart import SainSmartBoard
from hardware.rig.configuration import Rig

DRIVERS: dict[str, type[RelayBoard]] = {
    "feedback": FeedbackBoard,
    "gd32": Gd32Board,
    "lcus": LcusBoard,
    "modbus": ModbusBoard,
    "numato": NumatoBoard,
    "sainsmart": SainSmartBoard,
}
"""Each opens a board by port, number of channels and clock."""


@contextmanager
def open_board(rig: Rig, clock: Clock | None = None, port: str | None = None) -> Iterator[RelayBoard]:
    """The board of a rig, at another port where one is given; closing it leaves the contacts as they are."""
    url = port or rig.board.port
    if url is None:
        raise InputError("the rig file names no port", remedy="set board.port")
    board = DRIVERS[rig.board.kind](url, rig.board.channels, clock or WallClock())
    try:
        yield board
    finally:
        board.close()
