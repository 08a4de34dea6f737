"""The driver and the emulator of the board that a rig file names."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pkgutil import resolve_name

from eldir.errors import InputError
from eldir_hardware.clock import Clock, WallClock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.relay.board import RelayBoard, RunRequirements
from eldir_hardware.relay.errors import PortError
from eldir_hardware.relay.registration import board_of
from eldir_hardware.rig.board_identity import Port, open_device
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.port_holder import holder_of

_logger = logging.getLogger(__name__)


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
            code="package.broken",
            found=f"{type(error).__name__}: {error}",
            remedy="repair the package that provides this board",
        ) from None
    return found


def is_retriggerable(rig: Rig) -> bool | None:
    """Whether a second pulse restarts the board's timer: as its protocol says, or as measured; None if
    unknown."""
    known = driver_of(rig.board.kind).retriggerable
    return rig.board.retriggerable if known is None else known


def requirements_of(rig: Rig) -> RunRequirements:
    """What runs on this rig ask of the board at most."""
    others = {rig.fan_channel, rig.master_channel}
    return RunRequirements(
        min(rig.limits.max_on_s, rig.cutoff_s or rig.limits.max_on_s),
        rig.limits.duty,
        frozenset(c.channel for c in rig.channels),
        frozenset(c for c in others if c is not None),
    )


@contextmanager
def open_board(rig: Rig, clock: Clock | None = None, port: Port | None = None) -> Iterator[RelayBoard]:
    """The board of a rig, or at another port or of a device where one is given.

    Closing it leaves the contacts as they are.

    Raises `PortError` where the port cannot be opened, with the process that drives it if there is one.
    """
    url = port or rig.require_port()
    try:
        driver, clock = driver_of(rig.board.kind), clock or WallClock()
        board = open_device(url, lambda where: driver(where, rig.board.channels, clock), PortError)
    except PortError:
        holder = holder_of(url)
        if holder is None:
            raise
        problem, remedy = (
            f"process {holder.process} already drives {url}",
            "wait for it, or stop it: eldir rig off",
        )
        raise PortError(problem, code="board.port-in-use", remedy=remedy) from None
    _logger.info("board of kind %s with %d channels at %s", rig.board.kind, rig.board.channels, url)
    try:
        yield board
    finally:
        board.close()
