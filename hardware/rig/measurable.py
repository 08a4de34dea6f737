"""Whether a current sensor's chips and shunts fit the currents and voltages of a rig."""

from __future__ import annotations

from hardware.rig.sections import SensorEntry, SpringEntry, SupplyEntry
from hardware.sensor.chips import CHIPS

_HEADROOM = 1.25  # a current beyond the limit must still be measured, not only seen as too large
_LEAST_PART = 0.1  # of the supply's limit, which must be told from no current


def problem_of(sensor: SensorEntry, supply: SupplyEntry, springs: SpringEntry) -> str | None:
    """Why these chips cannot measure these springs; None where they can."""
    chip, limit = CHIPS[sensor.kind], supply.current_limit_a
    if supply.voltage_v > chip.most_volts:
        return (
            f"sensor: {sensor.kind} inputs stand {chip.most_volts:g} V, the supply has {supply.voltage_v:g} V"
        )
    if springs.resistance_tolerance > sensor.resistance_tolerance:
        return "sensor.resistance_tolerance is smaller than springs.resistance_tolerance"
    if limit is None:
        return None  # such a rig does not arm
    if chip.full_scale(sensor.shunt_ohm) < _HEADROOM * limit:
        largest = chip.full_scale(1.0) / (_HEADROOM * limit)
        return f"sensor.shunt_ohm is too large for {limit:g} A: expected at most {largest:.3g} Ohm"
    smallest = chip.smallest_shunt(_LEAST_PART * limit)
    if sensor.shunt_ohm < smallest:
        return f"sensor.shunt_ohm is too small for {limit:g} A: expected at least {smallest:.3g} Ohm"
    return None
