"""Heat of one spring from the supply, alone or together with others on a shared output."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.parameters.springs import SpringParameters
from hardware.rig.configuration import Rig


class LimitError(EldirError):
    """Heating is refused."""


def worst_springs(rig: Rig) -> SpringParameters:
    """The springs that get hottest within the rig file's tolerance. Raises `LimitError` without measurements.

    A fan counts only where the heating supply is cut by hardware when the fan stands still.
    """
    for name, value in (
        ("springs.resistance_ohm", rig.springs.resistance_ohm),
        ("supply.current_limit_a", rig.supply.current_limit_a),
    ):
        if value is None:
            raise LimitError(
                f"the rig file lacks {name}",
                expected="a measured value",
                remedy="measure it and write it there: without it no temperature can be predicted",
            )
    nominal = rig.spring_parameters(fan=rig.fan is not None and rig.fan.interlocked)
    return max(
        (nominal.with_resistance(r) for r in _tolerated(nominal, rig)), key=lambda p: float(p.power(0.0))
    )


def _tolerated(nominal: SpringParameters, rig: Rig) -> list[float]:
    """Candidate resistances [Ohm]; one of them gives the most heat."""
    # At the supply's current limit more resistance means more heat, below it less.
    low, high = (nominal.resistance * (1.0 + s * rig.springs.resistance_tolerance) for s in (-1, 1))
    turning = nominal.supply_voltage / nominal.current_limit - nominal.lead_resistance
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
        nominal = rig.spring_parameters(fan=False)
        candidates = _tolerated(nominal, rig)
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
    """Raise `LimitError` if so many springs at once exceed the supply's budget or a contact's rating."""
    one = float(worst_springs(rig).current(0.0))
    if one > rig.board.contact_rating_a:
        raise LimitError(
            "the current exceeds the relay contacts' rating",
            expected=f"at most {rig.board.contact_rating_a:g} A",
            found=f"{one:.1f} A",
        )
    each = rig.supply.current_limit_a or one
    if rig.supply.outputs == "shared":
        together = min(together, 1)  # the limit holds for all of them
    if together * each > rig.supply.budget_a + 1e-9:
        raise LimitError(
            "too many springs heat at once",
            expected=f"at most {rig.supply.budget_a:g} A",
            found=f"{together} x {each:g} A",
            remedy="move the phases apart",
        )
