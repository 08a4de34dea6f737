"""Heat of springs from the supply, also on a shared output, and the extremes within the tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.parameters.springs import (
    CORRELATION_ERROR,
    SpringParameters,
    fan_heat_transfer_coefficient,
    forced_convection,
    max_still_air_temperature,
    min_heat_transfer_coefficient,
    wire_heat_transfer_coefficient,
)
from eldir_hardware.rig.configuration import Rig

_MAX_AIR_SPEED = 5.0  # of a strong fan [m/s]
_HOT_TEMPERATURE = 90.0  # spring at the highest temperature limit [C]
_MIN_DIFFERENCE = (
    10.0  # above ambient, where a coefficient in still air is taken that is too low for hotter springs [K]
)


class LimitError(EldirError):
    """Heating is refused because of a limit."""

    code = "limit"


def worst_springs(rig: Rig) -> SpringParameters:
    """The springs that get hottest within the rig file's tolerances. Raises `LimitError` if not measured.

    Hottest air, largest current, the resistance with most heat, weakest air flow. A fan counts only if
    hardware cuts the heating supply when the fan stops.
    """
    require_measured(rig)
    corner = _hottest_corner(rig)
    return max(
        (corner.with_resistance(r) for r in _extreme_resistances(corner, rig)),
        key=lambda p: float(p.power(0.0)),
    )


def coldest_springs(rig: Rig) -> SpringParameters:
    """The springs that stay coldest within the rig file's tolerances, and move least."""
    require_measured(rig)
    corner = springs_at_tolerances(rig, rig.spring_parameters(), current=-1, convection=1, room=-1)
    return min(
        (corner.with_resistance(r) for r in _extreme_resistances(corner, rig)),
        key=lambda p: float(p.power(0.0)),
    )


def springs_at_tolerances(
    rig: Rig, springs: SpringParameters, current: float = 0.0, convection: float = 0.0, room: float = 0.0
) -> SpringParameters:
    """Springs on a rig that is off by these parts of its tolerances, -1 to 1; their resistance stays."""
    allowed = rig.tolerances
    supply, air = 1.0 + allowed.current * current, 1.0 + allowed.convection_tolerance * convection
    reach = (allowed.ambient_max_c if room > 0 else allowed.ambient_min_c) - springs.ambient
    return replace(
        springs,
        ambient=springs.ambient + abs(room) * reach,
        supply_voltage=springs.supply_voltage * supply,
        current_limit=springs.current_limit * supply,
        convection_fan=springs.convection_fan * air,
        convection_still=springs.convection_still * air,
    )


def find_implausible_springs(rig: Rig) -> dict[str, str]:
    """A sentence for each thermal constant of the rig file outside of published ranges, by name.

    Heat capacity and latent heat: from table II of PMC5687518 (IEEE T-RO 2017) to Dynalloy's technical sheet
    F1140. Losses: by the correlations of `eldir.parameters.springs`, from a coil in still air, or in a
    stream of 0.3 m/s, to a straight wire in still air at 90 C, or in a stream of 5 m/s.
    """
    springs = rig.spring_parameters(fan=False)
    wire, air = springs.wire_diameter, springs.ambient
    least = min_heat_transfer_coefficient(springs, air + _MIN_DIFFERENCE)
    ranges = {
        "heat_capacity": (466.0, 837.0, "J/(kg K)"),
        "latent_heat": (12_200.0, 24_200.0, "J/kg"),
        "convection_fan": (least, forced_convection(wire, _MAX_AIR_SPEED, _HOT_TEMPERATURE, air), "W/(m2 K)"),
        "convection_still": (
            least,
            (1 + CORRELATION_ERROR) * wire_heat_transfer_coefficient(wire, _HOT_TEMPERATURE, air),
            "W/(m2 K)",
        ),
    }
    found = {}
    for name, (low, high, unit) in ranges.items():
        value = getattr(rig.springs, name)
        if value is not None and not low * (1 - 1e-6) <= value <= high * (1 + 1e-6):
            source = (
                "as eldir calibrate springs measured" if name in rig.springs.calibrated else "not measured"
            )
            found[name] = (
                f"springs.{name} is implausible: expected {low:.5g} to {high:.5g} {unit}, found {value:g} "
                f"({source}); measure it: eldir calibrate springs"
            )
    return found


def steady_temperature_in_still_air(rig: Rig) -> float:
    """Steady temperature of a spring that stays on, in the worst corner and alone on the supply [C]."""
    worst = replace(worst_springs(rig), fan=False)
    if "convection_still" in rig.springs.calibrated:
        return worst.steady_temperature
    computed = max_still_air_temperature(worst, max(float(worst.power(0.0)), float(worst.power(1.0))))
    if (written := rig.springs.convection_still) is None:
        return computed
    still = written * (1 - rig.tolerances.convection_tolerance)
    return max(computed, replace(worst, convection_still=still).steady_temperature)


def require_measured(rig: Rig) -> None:
    """Raise `LimitError` where the rig file lacks a value without which no heat can be predicted."""
    values = {
        "springs.resistance_ohm": rig.springs.resistance_ohm,
        "supply.current_limit_a": rig.supply.current_limit_a,
    }
    missing = [name for name, value in values.items() if value is None]
    if not missing:
        return
    them = "it" if len(missing) == 1 else "them"
    raise LimitError(
        f"missing in the rig file: {' and '.join(missing)}",
        code="limit.not-measured",
        key=missing[0],
        expected="a measured value" if len(missing) == 1 else "measured values",
        remedy=f"measure {them} and write {them} there: without {them} no temperature can be predicted",
    )


def _hottest_corner(rig: Rig) -> SpringParameters:
    """Springs of nominal resistance in the hottest air, at the largest current, in the weakest air flow."""
    nominal = rig.spring_parameters(fan=rig.fan is not None and rig.fan.interlocked)
    allowed, measured = rig.tolerances, rig.springs.calibrated
    # Unmeasured values count only if they make springs hotter than the defaults.
    kit = SpringParameters(convection_fan=fan_heat_transfer_coefficient(nominal.wire_diameter))
    kept = {
        name: min(getattr(nominal, name), getattr(kit, name))
        for name in ("heat_capacity", "latent_heat", "convection_fan")
        if name not in measured
    }
    nominal = replace(nominal, **kept)
    hot = replace(
        nominal,
        ambient=allowed.ambient_max_c,
        supply_voltage=nominal.supply_voltage * (1 + allowed.current),
        current_limit=nominal.current_limit * (1 + allowed.current),
        convection_fan=nominal.convection_fan * (1 - allowed.convection_tolerance),
    )
    still, least = (
        rig.springs.convection_still,
        min_heat_transfer_coefficient(hot, hot.ambient + _MIN_DIFFERENCE),
    )
    if still is not None:
        still *= 1 - allowed.convection_tolerance
        least = still if "convection_still" in measured else min(still, least)
    return replace(hot, convection_still=least)


def _extreme_resistances(springs: SpringParameters, rig: Rig) -> list[float]:
    """Candidate resistances [Ohm]: one of them gives the most heat, one the least."""
    # At the supply's current limit more resistance means more heat, below it less.
    measured = rig.spring_parameters(fan=False).resistance
    low, high = (measured * (1.0 + s * rig.springs.resistance_tolerance) for s in (-1, 1))
    resistance_at_limit = springs.supply_voltage / springs.current_limit - springs.lead_resistance
    return [low, high, *([resistance_at_limit] if low < resistance_at_limit < high else [])]


def power_shares(rig: Rig, springs: SpringParameters, *, worst: bool = False) -> FloatArray:
    """Power of one spring while n heat, relative to its power alone, for n = 0, 1, ... all channels.

    It is always 1 with an output for each channel. `worst`: for a spring that draws more than the others,
    within the tolerance.
    """
    count = len(rig.channels)
    if rig.supply.outputs == "each":
        return np.ones(count + 1)
    alone = float(springs.power(0.0))
    others = springs.resistance
    candidates = [springs.resistance]
    if worst:
        candidates = _extreme_resistances(springs, rig)
        others = max(candidates)
    found = [
        1.0,
        *(
            max(_power_in_parallel(springs, r, others, n) for r in candidates) / alone
            for n in range(1, count + 1)
        ),
    ]
    return np.minimum(found, 1.0)


def _power_in_parallel(springs: SpringParameters, own: float, others: float, n: int) -> float:
    """Power of a spring in parallel with n - 1 others on an output of limited current [W]."""
    lead, limit = springs.lead_resistance, springs.current_limit
    mine, theirs = 1.0 / (own + lead), 1.0 / (others + lead)
    current = min(springs.supply_voltage * mine, limit * mine / (mine + (n - 1) * theirs))
    return current**2 * own


def scale_by_shares(on: FloatArray, parts: Sequence[float] | FloatArray) -> FloatArray:
    """Scale `on` (T, channels) by the springs' shares; channels that are closed for a whole step share."""
    simultaneous = np.clip((on > 1.0 - 1e-9).sum(axis=1), 1, None)
    return on * np.asarray(parts)[simultaneous][:, None]


def check_current(rig: Rig, simultaneous: int) -> None:
    """Raise `LimitError` if `simultaneous` springs exceed the supply's or a contact's rating, at the largest
    tolerated current."""
    worst = worst_springs(rig)
    one = float(worst.current(0.0))
    if one > rig.board.contact_rating_a:
        raise LimitError(
            "the current exceeds the relay contacts' rating",
            code="limit.contact-rating",
            expected=f"at most {rig.board.contact_rating_a:g} A",
            found=f"{one:.1f} A",
            remedy="lower supply.current_limit_a, or use a board with stronger contacts",
        )
    if rig.supply.outputs == "shared":
        simultaneous = min(simultaneous, 1)  # the limit holds for all of them
    if simultaneous * worst.current_limit > rig.supply.max_total_current_a + 1e-9:
        raise LimitError(
            "too many springs heat at once",
            code="limit.supply",
            expected=f"at most {rig.supply.max_total_current_a:g} A",
            found=f"{simultaneous} x {worst.current_limit:.3g} A",
            remedy="move the phases apart",
        )
