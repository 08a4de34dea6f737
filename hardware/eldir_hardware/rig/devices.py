"""The devices that a rig file names: driver and emulator of the board, and the current sensor."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pkgutil import resolve_name

from eldir.errors import InputError
from eldir_hardware.clock import Clock, WallClock
from eldir_hardware.current_sensor import CurrentSensor, SensorError
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.relay.board import RelayBoard, RunRequirements
from eldir_hardware.relay.errors import PortError
from eldir_hardware.relay.registration import get_board
from eldir_hardware.rig.board_identity import Port, open_device
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.port_holder import find_holder

_logger = logging.getLogger(__name__)


def get_driver(kind: str) -> type[RelayBoard]:
    """The class that drives boards of a kind."""
    return get_board(kind).driver


def get_emulator(kind: str) -> type[EmulatedBoard]:
    """The class that emulates boards of a kind."""
    name = get_board(kind).emulator
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
    known = get_driver(rig.board.kind).retriggerable
    return rig.board.retriggerable if known is None else known


def get_requirements(rig: Rig) -> RunRequirements:
    """The largest requirements of runs on this rig."""
    others = {rig.fan_channel, rig.master_channel}
    return RunRequirements(
        min(rig.limits.max_on_s, rig.cutoff_s or rig.limits.max_on_s),
        rig.limits.duty,
        frozenset(c.channel for c in rig.channels),
        frozenset(c for c in others if c is not None),
    )


@contextmanager
def open_board(rig: Rig, clock: Clock | None = None, port: Port | None = None) -> Iterator[RelayBoard]:
    """The board of a rig, or the one at `port`, as a context that leaves the contacts as they are.

    Raises `PortError` if the port cannot be opened, with the process that drives it if there is one.
    """
    url = port or rig.require_port()
    try:
        driver, clock = get_driver(rig.board.kind), clock or WallClock()
        board = open_device(url, lambda where: driver(where, rig.board.channels, clock), PortError)
    except PortError:
        holder = find_holder(url)
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


def connect_sensor(rig: Rig, port: Port | None, clock: Clock) -> CurrentSensor | None:
    """Open the sensor of a rig, or the one at `port`; None if the rig has none."""
    entry = rig.sensor
    if entry is None:
        return None
    url = port or entry.port
    if url is None:
        problem = "the rig file names no port of the current sensor"
        raise InputError(problem, code="rig.no-port", remedy="set sensor.port")
    channels, shunt, lead = rig.measured_channels, entry.shunt_ohm, entry.lead_ohm
    return open_device(
        url,
        lambda at: CurrentSensor(at, entry.kind, channels, clock, shunt=shunt, lead=lead),
        SensorError,
    )


@contextmanager
def open_sensor(
    rig: Rig, clock: Clock | None = None, port: Port | None = None
) -> Iterator[CurrentSensor | None]:
    """The sensor of a rig, or the one at `port`, as a context; None if the rig has none."""
    sensor = connect_sensor(rig, port, clock or WallClock())
    try:
        yield sensor
    finally:
        if sensor is not None:
            sensor.close()
