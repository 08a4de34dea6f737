"""The current sensor that a rig file names."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from eldir.errors import InputError
from eldir_hardware.clock import Clock, WallClock
from eldir_hardware.rig.board_identity import Port, open_device
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.sensor.driver import CurrentSensor
from eldir_hardware.sensor.errors import SensorError


def sensor_of(rig: Rig, port: Port | None, clock: Clock) -> CurrentSensor | None:
    """The sensor of a rig, or the one at another port, or that very device; None where the rig has none."""
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
    """The sensor of a rig between the beginning and the end of a `with`; None where the rig has none."""
    sensor = sensor_of(rig, port, clock or WallClock())
    try:
        yield sensor
    finally:
        if sensor is not None:
            sensor.close()
