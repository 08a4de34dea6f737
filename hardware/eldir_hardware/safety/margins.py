"""Margins of a schedule: how far beyond its tolerances a rig may be until a spring reaches the ceiling."""

from __future__ import annotations

from collections.abc import Callable

from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import coldest_springs, shared_on, shares
from eldir_hardware.safety.limits import LimitError, check_heat, on_in_period
from eldir_hardware.safety.repeated_heat import run_until_repeated
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.schedule_prediction import HeatMargins

_CURRENT, _AMBIENT, _LONGER = (
    (2.0, 0.01),
    (40.0, 0.1),
    (6.0, 0.02),
)  # the search's end and exactness [A, K, s]


def heat_margins(schedule: ActuationSchedule, rig: Rig) -> HeatMargins:
    """The margins of a schedule that the rig allows, each alone, with all else in the worst corner.

    The ceiling holds for pulses a step longer than scheduled and for a contact that welds, as when a schedule
    is checked. Zero where nothing is left.
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

    peak, stroke = _coldest(schedule, rig)
    return HeatMargins(
        current_a=_last(lambda more: holds(current=allowed.current + more / nominal), *_CURRENT),
        ambient_c=_last(lambda more: holds(ambient_max_c=allowed.ambient_max_c + more), *_AMBIENT),
        longer_s=_last(lambda more: holds(longer=more), *_LONGER),
        coldest_c=peak,
        coldest_stroke=stroke,
    )


def describe(margins: HeatMargins, rig: Rig) -> str:
    """The margins in two sentences."""
    allowed = rig.tolerances
    return (
        f"margins beyond the rig file's tolerances until {rig.limits.max_temperature_c:g} C: "
        f"{margins.current_a:.2f} A more current, air {margins.ambient_c:.1f} C hotter than "
        f"{allowed.ambient_max_c:g} C, or pulses {margins.longer_s:.2f} s longer; "
        f"at {allowed.ambient_min_c:g} C with the least current springs reach {margins.coldest_c:.0f} C "
        f"and use {margins.coldest_stroke:.0%} of their stroke"
    )


def _coldest(schedule: ActuationSchedule, rig: Rig) -> tuple[float, float]:
    """Peak temperature [C] and used part of the stroke of springs in the coldest corner."""
    springs = coldest_springs(rig)
    on = shared_on(on_in_period(schedule.pulses(), schedule.period_s), shares(rig, springs))
    history = run_until_repeated(on, schedule.period_s / len(on), springs, rig.limits.max_temperature_c)
    used = float((history.martensite.max(axis=0) - history.martensite.min(axis=0)).min())
    return round(float(history.temperature.max()), 1), round(used, 3)


def _last(holds: Callable[[float], bool], most: float, exact: float) -> float:
    """The largest value up to `most` for which something still holds; 0 if it never does."""
    low, high = 0.0, most
    if holds(most):
        return most
    while high - low > exact:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return round(low, 2)
