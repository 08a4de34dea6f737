"""Margins of a schedule: how far beyond its tolerances a rig may be until a spring reaches its limit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import MEASURED_CURRENT
from eldir_hardware.rig.supply import coldest_springs, power_shares, scale_by_shares
from eldir_hardware.safety.limits import LimitError, check_heat, check_schedule, on_fractions
from eldir_hardware.safety.worst_heat import run_until_periodic
from eldir_hardware.schedule import ActuationSchedule, HeatMargins

# Largest value and tolerance of each search.
_CURRENT_SEARCH = (2.0, 0.01)  # [A]
_AMBIENT_SEARCH = (40.0, 0.1)  # [K]
_PULSE_SEARCH = (6.0, 0.02)  # [s]
_LIMIT_SEARCH = (2.0, 0.005)  # [A]
SUPPLY_STEP = 0.05
"""Step of a supply's current limit that is advised [A]."""
_MEASURED_AIR = 3.0  # tolerance of the air's temperature if it is measured before each run [K]


def heat_margins(schedule: ActuationSchedule, rig: Rig) -> HeatMargins:
    """The margins of a schedule that the rig allows, each alone, with everything else in the worst corner.

    They hold for pulses one timer step longer than scheduled and for a contact that welds, as in the check of
    the schedule.
    """
    pulses, period, allowed = schedule.pulses(), schedule.period_s, rig.tolerances
    nominal = float(rig.spring_parameters().current(0.0))

    def holds(longer: float = 0.0, **changed: float) -> bool:
        other = rig.model_copy(update={"tolerances": allowed.model_copy(update=changed)})
        try:
            check_heat(pulses, period, other, longer)
        except LimitError:
            return False
        return True

    peak, stroke = coldest_peak_and_stroke(schedule, rig)
    return HeatMargins(
        current_a=_largest_allowed(
            lambda more: holds(current=allowed.current + more / nominal), *_CURRENT_SEARCH
        ),
        ambient_c=_largest_allowed(
            lambda more: holds(ambient_max_c=allowed.ambient_max_c + more), *_AMBIENT_SEARCH
        ),
        longer_s=_largest_allowed(lambda more: holds(longer=more), *_PULSE_SEARCH),
        coldest_c=peak,
        coldest_stroke=stroke,
    )


def describe_margins(margins: HeatMargins, rig: Rig) -> str:
    """A sentence on the margins."""
    allowed = rig.tolerances
    return (
        f"margins beyond the rig file's tolerances until {rig.limits.max_temperature_c:g} C: "
        f"{margins.current_a:.2f} A more current, air {margins.ambient_c:.1f} C hotter than "
        f"{allowed.ambient_max_c:g} C, or pulses {margins.longer_s:.2f} s longer; "
        f"at {allowed.ambient_min_c:g} C with the least current springs reach {margins.coldest_c:.0f} C "
        f"and use {margins.coldest_stroke:.0%} of their stroke"
    )


def rigs_with_narrower_tolerances(schedule: ActuationSchedule, rig: Rig) -> Iterator[Rig]:
    """The rig with the current measured to 2 %, with air within 3 K of `springs.ambient_c`, and with both.

    Each has the highest current limit, in steps of 0.05 A, with which `schedule` keeps the limits; where that
    is not higher than the rig's own, or its tolerances are as narrow already, none is yielded.
    """
    own, air = rig.tolerances, rig.springs.ambient_c
    current = {"current": min(own.current, MEASURED_CURRENT)}
    room = {
        "ambient_min_c": max(own.ambient_min_c, air - _MEASURED_AIR),
        "ambient_max_c": min(own.ambient_max_c, air + _MEASURED_AIR),
    }
    found: list[dict[str, float]] = []
    for changed in (current, room, current | room):
        narrower = own.model_copy(update=changed)
        if narrower != own and changed not in found:
            found.append(changed)
            other = _with_highest_current(schedule, rig.model_copy(update={"tolerances": narrower}))
            if other is not None:
                yield other


def _with_highest_current(schedule: ActuationSchedule, rig: Rig) -> Rig | None:
    """The rig with the highest current limit that the schedule allows; None if its own is the highest."""
    springs, (search, tolerance) = rig.spring_parameters(), _LIMIT_SEARCH
    own = springs.current_limit
    if rig.supply.outputs == "each":  # beyond this its voltage limits a spring's current
        ohms = springs.resistance + springs.lead_resistance
        search = min(search, springs.supply_voltage / ohms - own)

    def with_limit(current: float) -> Rig:
        return rig.model_copy(
            update={"supply": rig.supply.model_copy(update={"current_limit_a": round(current, 2)})}
        )

    def holds(more: float) -> bool:
        if with_limit(own + more).find_series_problem():
            return False
        try:
            check_schedule(schedule, with_limit(own + more))
        except LimitError:
            return False
        return True

    highest = own + _largest_allowed(holds, search, tolerance)
    highest = SUPPLY_STEP * math.floor(highest / SUPPLY_STEP + 1e-6)
    return with_limit(highest) if highest > own + SUPPLY_STEP / 2 else None


def coldest_peak_and_stroke(schedule: ActuationSchedule, rig: Rig) -> tuple[float, float]:
    """Peak temperature [C] and used part of the stroke of springs in the coldest corner."""
    springs = coldest_springs(rig)
    on = scale_by_shares(on_fractions(schedule.pulses(), schedule.period_s), power_shares(rig, springs))
    history = run_until_periodic(on, schedule.period_s / len(on), springs, rig.limits.max_temperature_c)
    used = float((history.martensite.max(axis=0) - history.martensite.min(axis=0)).min())
    return round(float(history.temperature.max()), 1), round(used, 3)


def _largest_allowed(holds: Callable[[float], bool], max_value: float, tolerance: float) -> float:
    """The largest value up to `max_value` for which `holds` is true; 0 if it never is."""
    low, high = 0.0, max_value
    if holds(max_value):
        return max_value
    while high - low > tolerance:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return round(low, 2)
