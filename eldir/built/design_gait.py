"""The gait that a design carries in its provenance: evolved with it, or found by `eldir shortlist`."""

from __future__ import annotations

from typing import Any

from eldir.built.gait import Gait
from eldir.design import Design
from eldir.errors import InputError

_KEY = "gait"


def as_provenance(gait: Gait) -> dict[str, Any]:
    """What a design's provenance holds about its gait, as plain values."""
    return {
        _KEY: {
            "period_s": gait.period,
            "phase": gait.phase.tolist(),
            "duty": gait.duty.tolist(),
            "method": gait.method,
        }
    }


def gait_of(design: Design) -> Gait | None:
    """The gait of a design; None if it carries none.

    Raises `InputError` if it is damaged or does not fit the design's motors.
    """
    values = design.provenance.get(_KEY)
    if values is None:
        return None
    try:
        gait = Gait(float(values["period_s"]), values["phase"], values["duty"], str(values["method"]))
    except (KeyError, TypeError, ValueError, InputError) as error:
        raise InputError(
            "the design's gait is damaged",
            expected="period_s, phase, duty and method",
            found=f"{type(error).__name__}: {error}"[:100],
            remedy="run eldir shortlist again",
        ) from None
    motors = design.morphology.motors
    if len(gait.phase) != motors:
        raise InputError(
            "the design's gait does not fit its motors", expected=str(motors), found=str(len(gait.phase))
        )
    return gait
