"""Errors of the current sensor."""

from eldir.errors import EldirError


class SensorError(EldirError):
    """The current sensor cannot be trusted: the heat that was to be seen is not seen."""

    code = "sensor"
