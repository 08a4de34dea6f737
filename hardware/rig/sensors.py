"""The current sensor that a rig file names."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from eldir.errors import InputError
from hardware.clock import Clock, WallClock
from hardware.rig.configuration import Rig
from hardware.sensor.driver import CurrentSensor


def sensor_of(rig: Rig, port: str | None, clock: Clock) -> CurrentSensor | None:
    """The sensor of a rig, at another port where one is given; None where the rig has none."""
    entry = rig.sensor
    if entry is None:
        return None
    url = port or entry.port
    if url is None:
        raise InputError("the rig file names no port of the current sensor", remedy="set sensor.port")
    return CurrentSensor(
        url, entry.kind, rig.measured_channels, clock, shunt=entry.shunt_ohm, lead=entry.lead_ohm
    )


@contextmanager
def open_sensor(
    rig: Rig, clock: Clock | None = None, port: str | None = None
) -> Iterator[CurrentSensor | None]:
    """The sensor of a rig between the beginning and the end of a `with`; None where the rig has none."""
    sensor = sensor_of(rig, port, clock or WallClock())
    try:
        yield sensor
    finally:
        if sensor is not None:
            sensor.close()
