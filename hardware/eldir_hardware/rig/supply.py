"""Heat of one spring from the supply, alone or together with others on a shared output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.parameters.springs import SpringParameters
from eldir.parameters.still_air import (
    SCATTER,
    forced_convection,
    hottest_in_still_air,
    least_coefficient,
    wire_coefficient,
)
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import SpringEntry

_FASTEST, _HOT = 5.0, 90.0  # stream of a strong fan [m/s], spring at the highest ceiling [C]


class LimitError(EldirError):
    """Heating is refused."""

    code = "limit"


_COOLEST = (
    10.0  # above ambient, where a coefficient in still air is taken that is too low for hotter springs [K]
)


def worst_springs(rig: Rig) -> SpringParameters:
    """The springs that get hottest within the rig file's tolerances. Raises `LimitError` if not measured.

    Hottest air, greatest current, the resistance with the most heat, weakest air stream. A fan counts only
    where the heating supply is cut by hardware when the fan stands still.
    """
    _require_measured(rig)
    corner = _corner(rig)
    return max(
        (corner.with_resistance(r) for r in _tolerated(corner, rig)), key=lambda p: float(p.power(0.0))
    )


def coldest_springs(rig: Rig) -> SpringParameters:
    """The springs that stay coldest within the rig file's tolerances: not dangerous, but they move less."""
    _require_measured(rig)
    nominal, allowed = rig.spring_parameters(), rig.tolerances
    corner = replace(
        nominal,
        ambient=allowed.ambient_min_c,
        supply_voltage=nominal.supply_voltage * (1 - allowed.current),
        current_limit=nominal.current_limit * (1 - allowed.current),
        convection_fan=nominal.convection_fan * (1 + allowed.convection_tolerance),
    )
    return min(
        (corner.with_resistance(r) for r in _tolerated(corner, rig)), key=lambda p: float(p.power(0.0))
    )


def implausible_springs(rig: Rig) -> dict[str, str]:
    """Thermal constants of the rig file outside what is published for such springs, by name, in one sentence.

    Heat capacity and latent heat: from table II of PMC5687518 (IEEE T-RO 2017) to Dynalloy's technical sheet
    F1140. Losses: by the correlations of `eldir.parameters.still_air`, from a coil in still air, or in a
    stream of 0.3 m/s, to a straight wire in still air at 90 C, or in a stream of 5 m/s.
    """
    springs = rig.spring_parameters(fan=False)
    wire, air = springs.wire_diameter, springs.ambient
    least = least_coefficient(springs, air + _COOLEST)
    ranges = {
        "heat_capacity": (466.0, 837.0, "J/(kg K)"),
        "latent_heat": (12_200.0, 24_200.0, "J/kg"),
        "convection_fan": (least, forced_convection(wire, _FASTEST, _HOT, air), "W/(m2 K)"),
        "convection_still": (least, (1 + SCATTER) * wire_coefficient(wire, _HOT, air), "W/(m2 K)"),
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


def settled_in_still_air(rig: Rig) -> float:
    """Temperature at which a spring that stays on settles in the worst corner, alone on the supply [C]."""
    worst = replace(worst_springs(rig), fan=False)
    if "convection_still" in rig.springs.calibrated:
        return worst.steady_temperature
    computed = hottest_in_still_air(worst, max(float(worst.power(0.0)), float(worst.power(1.0))))
    if (written := rig.springs.convection_still) is None:
        return computed
    still = written * (1 - rig.tolerances.convection_tolerance)
    return max(computed, replace(worst, convection_still=still).steady_temperature)


def _require_measured(rig: Rig) -> None:
    values = {
        "springs.resistance_ohm": rig.springs.resistance_ohm,
        "supply.current_limit_a": rig.supply.current_limit_a,
    }
    lacking = [name for name, value in values.items() if value is None]
    if not lacking:
        return
    them = "it" if len(lacking) == 1 else "them"
    raise LimitError(
        f"the rig file lacks {' and '.join(lacking)}",
        code="limit.not-measured",
        key=lacking[0],
        expected="a measured value" if len(lacking) == 1 else "measured values",
        remedy=f"measure {them} and write {them} there: without {them} no temperature can be predicted",
    )


def _corner(rig: Rig) -> SpringParameters:
    """Springs of nominal resistance in the hottest air, at the greatest current, in the weakest stream."""
    nominal = rig.spring_parameters(fan=rig.fan is not None and rig.fan.interlocked)
    allowed, measured = rig.tolerances, rig.springs.calibrated
    # Values of a person count only where they make springs hotter than the defaults do.
    kept = {
        name: min(getattr(nominal, name), SpringEntry.model_fields[name].default)
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
    still, least = rig.springs.convection_still, least_coefficient(hot, hot.ambient + _COOLEST)
    if still is not None:
        still *= 1 - allowed.convection_tolerance
        least = still if "convection_still" in measured else min(still, least)
    return replace(hot, convection_still=least)


def _tolerated(springs: SpringParameters, rig: Rig) -> list[float]:
    """Candidate resistances [Ohm]; one of them gives the most heat, and one the least."""
    # At the supply's current limit more resistance means more heat, below it less.
    measured = rig.spring_parameters(fan=False).resistance
    low, high = (measured * (1.0 + s * rig.springs.resistance_tolerance) for s in (-1, 1))
    turning = springs.supply_voltage / springs.current_limit - springs.lead_resistance
    return [low, high, *([turning] if low < turning < high else [])]


def shares(rig: Rig, springs: SpringParameters, *, worst: bool = False) -> FloatArray:
    """The heat of one spring while n heat, as a part of its heat alone, for n = 0, 1, ... all channels.

    With an output for each it is always 1. `worst`: a spring that draws more than the others, within
    the tolerance.
    """
    count = len(rig.channels)
    if rig.supply.outputs == "each":
        return np.ones(count + 1)
    alone = float(springs.power(0.0))
    others = springs.resistance
    candidates = [springs.resistance]
    if worst:
        candidates = _tolerated(springs, rig)
        others = max(candidates)
    found = [
        1.0,
        *(max(_heat(springs, r, others, n) for r in candidates) / alone for n in range(1, count + 1)),
    ]
    return np.minimum(found, 1.0)


def _heat(springs: SpringParameters, own: float, others: float, n: int) -> float:
    """Heat of a spring in parallel with n - 1 others on an output of limited current [W]."""
    lead, limit = springs.lead_resistance, springs.current_limit
    mine, theirs = 1.0 / (own + lead), 1.0 / (others + lead)
    current = min(springs.supply_voltage * mine, limit * mine / (mine + (n - 1) * theirs))
    return current**2 * own


def shared_on(on: FloatArray, parts: Sequence[float] | FloatArray) -> FloatArray:
    """`on` (T, channels) scaled by each spring's share; channels closed for a whole step take a share."""
    together = np.clip((on > 1.0 - 1e-9).sum(axis=1), 1, None)
    return on * np.asarray(parts)[together][:, None]


def check_current(rig: Rig, together: int) -> None:
    """Raise `LimitError` if so many springs at once exceed the supply's budget or a contact's rating, at the
    greatest tolerated current."""
    worst = worst_springs(rig)
    one = float(worst.current(0.0))
    if one > rig.board.contact_rating_a:
        raise LimitError(
            "the current exceeds the relay contacts' rating",
            code="limit.contact-rating",
            expected=f"at most {rig.board.contact_rating_a:g} A",
            found=f"{one:.1f} A",
        )
    if rig.supply.outputs == "shared":
        together = min(together, 1)  # the limit holds for all of them
    if together * worst.current_limit > rig.supply.max_total_current_a + 1e-9:
        raise LimitError(
            "too many springs heat at once",
            code="limit.supply",
            expected=f"at most {rig.supply.max_total_current_a:g} A",
            found=f"{together} x {worst.current_limit:.3g} A",
            remedy="move the phases apart",
        )
