"""Layer 0: a contact that welds shut must be harmless. Nothing here relies on a contact opening."""

from __future__ import annotations

import numpy as np

from eldir.built.heat import HeatModel, SpringState
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters
from eldir_hardware.rig.boards import driver_of, is_retriggerable
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import ContactorEntry, ThermalEntry
from eldir_hardware.rig.supply import LimitError, settled_in_still_air
from eldir_hardware.safety.repeated_heat import run_until_repeated

_DT = 0.05
_REMEDY = "lower supply.current_limit_a, or add an independent cut-off to the rig and its file"


def check_board(rig: Rig) -> None:
    """Raise `LimitError` for a board with an unmeasured timer, or a cut-off that fails together with it."""
    driver = driver_of(rig.board.kind)
    timed, retriggerable = driver.times_pulses, is_retriggerable(rig)
    if timed and retriggerable is None:
        raise LimitError(
            "it is not known whether a second pulse restarts this board's timer or is ignored",
            code="limit.unknown-timer",
            expected="board.retriggerable",
            remedy="disconnect the heat, then: eldir rig doctor --pulses --rig RIG",
        )
    if isinstance(rig.cutoff, ContactorEntry) and driver.fails_closed:
        raise LimitError(
            "the contactor's own switch would fail closed as those of the springs do",
            code="limit.contactor-fails-closed",
            expected="a cut-off that this board does not drive",
            found=f"a contactor on a board of kind {rig.board.kind}",
            remedy="use timer relays or thermal switches",
        )
    if isinstance(rig.cutoff, ContactorEntry) and not (timed and retriggerable):
        raise LimitError(
            "the contactor would stay closed when this computer dies",
            code="limit.contactor-stays-closed",
            expected="a board that times its pulses and restarts them",
            found=rig.board.kind,
            remedy="use such a board, or a cut-off that the computer does not drive",
        )


def stuck_temperature(
    rig: Rig,
    worst: SpringParameters,
    starts: SpringState | None,
    any_on: FloatArray | None = None,
    step: float = _DT,
) -> float:
    """How hot a spring gets when its contact welds shut [C]; refused above the ceiling.

    Safe is (a) a current so small that the spring settles below the ceiling in still air, alone on the
    supply, or (b) a cut-off. `starts`: springs at the start of their pulses, hottest moments. `any_on`
    (T,): whether anything heats in each `step` [s] of a period: with a contactor a welded spring heats too.
    """
    steady = settled_in_still_air(rig)
    ceiling = rig.limits.max_temperature_c
    if steady <= ceiling:
        return steady
    if rig.cutoff is None:
        problem = "a relay contact welded shut would burn its spring"
        raise _stuck(problem, rig, f"{steady:.0f} C in still air")
    if isinstance(rig.cutoff, ThermalEntry):
        if rig.cutoff.opens_at_c > ceiling:
            found = f"{rig.cutoff.opens_at_c:g} C"
            raise _stuck("the thermal switches would open too late", rig, found)
        return rig.cutoff.opens_at_c
    if isinstance(rig.cutoff, ContactorEntry):
        if any_on is None:
            return worst.ambient
        hottest = float(run_until_repeated(any_on[:, None], step, worst, ceiling).temperature.max())
        if hottest > ceiling:
            problem = "with a contact welded shut, the contactor would let its spring get too hot"
            raise _stuck(problem, rig, f"{hottest:.1f} C")
        return hottest
    starts = starts or SpringState.cold(1, worst)
    count = len(starts.temperature)
    steps = int(np.ceil(rig.cutoff.max_on_s / _DT))
    held = HeatModel([worst] * count).run(np.ones((steps, count)), _DT, starts)
    hottest = float(held.temperature.max())
    if hottest > ceiling:
        problem = "the cut-off would act too late for a relay contact welded shut"
        raise _stuck(problem, rig, f"{hottest:.1f} C after {rig.cutoff.max_on_s:g} s")
    return hottest


def _stuck(problem: str, rig: Rig, found: str) -> LimitError:
    """The error for a contact that stays closed, and makes its spring too hot."""
    ceiling = f"at most {rig.limits.max_temperature_c:g} C"
    return LimitError(problem, code="limit.stuck-contact", expected=ceiling, found=found, remedy=_REMEDY)
