"""The air around the springs, measured before a run: by the rig's thermometer, or entered by a person."""

from __future__ import annotations

from typing import NamedTuple

from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.limits import check_room
from eldir_hardware.thermometer import ThermometerError, read_thermometer
from eldir_hardware.virtual.rig import thermometer_reading

_MAX_DIFFERENCE = 2.0  # between both: thermometers and rooms differ by less [K]


class MeasuredRoom(NamedTuple):
    """The air before a run."""

    room_c: float | None
    """Its temperature [C]; None if it was not measured."""
    text: str = ""
    """How it was measured, as a sentence for the log; empty if it was not."""
    is_doubtful: bool = False
    """Whether the thermometer contradicts the entered temperature, or cannot be read."""


def measure_room(rig: Rig, entered: float | None = None) -> MeasuredRoom:
    """The air now. `entered`: as a person measured it [C]; it takes precedence over the thermometer.

    Raises `ThermometerError` if there is nothing but a thermometer that does not work, and `LimitError` for
    air outside of the rig file's tolerances.
    """
    found = _measure(rig, entered)
    check_room(rig, found.room_c)
    return found


def with_room(rig: Rig, room_c: float | None) -> Rig:
    """The rig with this expected air [C], for the nominal springs of a run. Limits do not depend on it: they
    hold in the hottest air of the tolerances."""
    if room_c is None:
        return rig
    return rig.model_copy(update={"springs": rig.springs.model_copy(update={"ambient_c": room_c})})


def query_thermometer(rig: Rig) -> float | None:
    """What the rig's thermometer shows [C]; None if the rig file names none. Raises `ThermometerError`."""
    if rig.thermometer is None:
        return None
    if rig.kind == "virtual" or rig.thermometer.path is None:
        return thermometer_reading(rig)
    return read_thermometer(rig.thermometer.path)


def _measure(rig: Rig, entered: float | None) -> MeasuredRoom:
    if entered is None:
        shown = query_thermometer(rig)
        return MeasuredRoom(shown, "" if shown is None else f"the thermometer shows {shown:.1f} C")
    text = f"the air was measured before the run: {entered:g} C"
    try:
        shown = query_thermometer(rig)
    except ThermometerError as error:
        return MeasuredRoom(entered, f"{text}; {error}", is_doubtful=True)
    if shown is None or abs(shown - entered) <= _MAX_DIFFERENCE:
        return MeasuredRoom(entered, text)
    return MeasuredRoom(
        entered, f"{text}, but the thermometer shows {shown:.1f} C: {entered:g} C is used", is_doubtful=True
    )
