"""Shortest period of heating and cooling on a rig that uses the whole stroke of the springs."""

from __future__ import annotations

import math

import numpy as np

from eldir.built.heat import HeatModel, time_to
from eldir.parameters.springs import SpringParameters
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.limits import WINDOW, check_heat, longest_pulse
from eldir_hardware.schedule import Pulse

_THROUGH = 2.0  # past Af when heated and below Mf when cooled, so that the transformation is complete [K]
_DT = 0.05
_SLOWER = (1.0, 1.25, 1.5)  # longer periods to try
_LONGEST = 300.0  # the search for the end of cooling stops here [s]


def own_timing(springs: SpringParameters, rig: Rig, motors: int) -> tuple[float, float]:
    """Period [s] and duty with which springs pass Af and are back below Mf, within the limits of the rig.

    Where springs in the worst corner of the tolerances would get too hot, the pauses are lengthened, and then
    the heating is shortened until they do not.
    """
    heating = min(time_to(springs.austenite_finish + _THROUGH, springs), longest_pulse(rig))
    period = _period(heating, springs, rig, motors)
    for slower in _SLOWER:
        if _cool(heating, round(slower * period, 1), rig):
            return round(slower * period, 1), heating / round(slower * period, 1)
    short, long = 0.0, heating
    period = round(_SLOWER[-1] * period, 1)
    while long - short > _DT:
        middle = (short + long) / 2
        short, long = (middle, long) if _cool(middle, period, rig) else (short, middle)
    heating = short or heating  # none is allowed: the rig's limits refuse it
    return period, heating / period


def _cool(heating: float, period: float, rig: Rig) -> bool:
    """Whether one channel that heats for so long in every period keeps the limits of heat."""
    try:
        check_heat([Pulse(rig.channels[0].channel, 0.0, heating)], period, rig)
    except LimitError:
        return False
    return True


def _period(heating: float, springs: SpringParameters, rig: Rig, motors: int) -> float:
    """Shortest period in which springs cool, and all of them can be heated one after another [s]."""
    steps = math.ceil(heating / _DT)
    on = np.concatenate([np.ones(steps), np.zeros(round(_LONGEST / _DT))])
    temperature = HeatModel([springs]).run(on[:, None], _DT).temperature[steps:, 0]
    goal = max(springs.martensite_finish - _THROUGH, springs.ambient + 0.5)
    cooled = np.flatnonzero(temperature < goal)
    cooling = _DT * (cooled[0] + 1) if len(cooled) else _LONGEST
    current = float(springs.current(0.0)) * (1 + rig.tolerances.current)
    at_once = max(1, int((rig.supply.max_total_current_a + 1e-9) // current))
    if rig.supply.outputs == "shared":
        at_once = 2 * motors
    rounds = math.ceil(2 * motors / at_once)  # every motor has a spring on both faces
    limits = rig.limits
    pause = max(cooling, limits.min_off_s)
    in_a_minute = max(1, int(limits.duty * WINDOW / heating + 1e-9))  # whole pulses
    return float(max(heating + pause, WINDOW / in_a_minute, rounds * heating))
