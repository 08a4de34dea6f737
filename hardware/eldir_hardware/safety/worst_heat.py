"""How hot springs get at worst: under periodic heating, and behind a contact that welds shut."""

from __future__ import annotations

import math

import numpy as np

from eldir.built.heat import HeatModel, SpringHistory, SpringState
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_driver, is_retriggerable
from eldir_hardware.rig.sections import ContactorEntry, ThermalEntry
from eldir_hardware.rig.supply import LimitError, steady_temperature_in_still_air

_MAX_CHANGE = 0.005  # change of a temperature over `_MIN_TIME` that counts as none [K]
_MIN_TIME = 15.0  # temperatures are compared after at least this time [s]
_MAX_PERIODS = 500  # number of comparisons; still air needs dozens
_DT = 0.05
_REMEDY = "lower supply.current_limit_a, or add an independent cut-off to the rig and its file"


def run_until_periodic(
    on: FloatArray, dt: float, springs: SpringParameters, max_temperature: float
) -> SpringHistory:
    """Simulate periods from cold until temperatures repeat or exceed `max_temperature` [C]; return the last.

    `on` (T, A): part of each step of `dt` [s] for which each spring is heated. Springs that start cold get
    hotter from period to period, so the last one has the highest temperature.
    """
    model = HeatModel([springs] * on.shape[1])
    together = max(1, math.ceil(_MIN_TIME / (len(on) * dt)))
    every = np.tile(on, (together, 1))
    state = SpringState.cold(on.shape[1], springs)
    for _ in range(_MAX_PERIODS):
        history = model.run(every, dt, state)
        change = float(abs(history.temperature[-1] - state.temperature).max())
        if change < _MAX_CHANGE or history.temperature.max() > max_temperature + 5.0:
            break
        state = history.final
    last = (getattr(history, name)[-len(on) :] for name in ("temperature", "martensite", "length", "current"))
    return SpringHistory(*last)


def check_board(rig: Rig) -> None:
    """Raise `LimitError` if the board's timer was not measured, or its cut-off fails together with it."""
    driver = get_driver(rig.board.kind)
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
            "the switch of the contactor fails closed as those of the springs do",
            code="limit.contactor-fails-closed",
            expected="a cut-off that this board does not drive",
            found=f"a contactor on a board of kind {rig.board.kind}",
            remedy="use timer relays or thermal switches",
        )
    if isinstance(rig.cutoff, ContactorEntry) and not (timed and retriggerable):
        raise LimitError(
            "the contactor would stay closed if this computer fails",
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
    """Highest temperature of a spring whose contact welds shut [C]. Raises `LimitError` above the limit.

    Safe is (a) a current so small that the spring settles below the limit in still air, alone on the
    supply, or (b) a cut-off. `starts`: springs at the hottest start of their pulses. `any_on`
    (T,): whether anything heats in each `step` [s] of a period: with a contactor a welded spring heats too.
    """
    settled = steady_temperature_in_still_air(rig)
    max_temperature = rig.limits.max_temperature_c
    if settled <= max_temperature:
        return settled
    if rig.cutoff is None:
        problem = "a relay contact welded shut would burn its spring"
        raise _stuck_error(problem, rig, f"{settled:.0f} C in still air")
    if isinstance(rig.cutoff, ThermalEntry):
        if rig.cutoff.opens_at_c > max_temperature:
            found = f"{rig.cutoff.opens_at_c:g} C"
            raise _stuck_error("the thermal switches would open too late", rig, found)
        return rig.cutoff.opens_at_c
    if isinstance(rig.cutoff, ContactorEntry):
        if any_on is None:
            return worst.ambient
        hottest = float(run_until_periodic(any_on[:, None], step, worst, max_temperature).temperature.max())
        if hottest > max_temperature:
            problem = "with a contact welded shut, the contactor would let its spring get too hot"
            raise _stuck_error(problem, rig, f"{hottest:.1f} C")
        return hottest
    starts = starts or SpringState.cold(1, worst)
    count = len(starts.temperature)
    steps = int(np.ceil(rig.cutoff.max_on_s / _DT))
    held = HeatModel([worst] * count).run(np.ones((steps, count)), _DT, starts)
    hottest = float(held.temperature.max())
    if hottest > max_temperature:
        problem = "the cut-off would act too late for a relay contact welded shut"
        raise _stuck_error(problem, rig, f"{hottest:.1f} C after {rig.cutoff.max_on_s:g} s")
    return hottest


def describe_early_cutoff(rig: Rig, peak_c: float) -> str:
    """That thermal switches open in normal operation, where the predicted temperature of nominal springs
    reaches `peak_c` [C]; else empty. No prediction contains the switches."""
    if rig.opens_at_c is None or peak_c < rig.opens_at_c:
        return ""
    return (
        f"nominal springs would reach {peak_c:.0f} C, but their thermal switches open at "
        f"{rig.opens_at_c:g} C or before: they stay colder and move less than predicted. Heat less, or take "
        "switches that open later, and set cutoff.opens_at_c"
    )


def _stuck_error(problem: str, rig: Rig, found: str) -> LimitError:
    """The error for a contact that stays closed and overheats its spring."""
    expected = f"at most {rig.limits.max_temperature_c:g} C"
    return LimitError(problem, code="limit.stuck-contact", expected=expected, found=found, remedy=_REMEDY)
