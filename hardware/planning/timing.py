"""Shortest period of heating and cooling on a rig that uses the whole stroke of the springs."""

from __future__ import annotations

import math

import numpy as np

from eldir.built.heat import HeatModel, time_to
from eldir.parameters.springs import SpringParameters
from hardware.rig.configuration import Rig
from hardware.safety.limits import longest_pulse

_THROUGH = 2.0  # past Af when heated and below Mf when cooled, so that the transformation is complete [K]
_DT = 0.05
_LONGEST = 300.0  # the search for the end of cooling stops here [s]


def own_timing(springs: SpringParameters, rig: Rig, motors: int) -> tuple[float, float]:
    """Period [s] and duty with which springs pass Af and are back below Mf, within the limits of the rig."""
    heating = min(time_to(springs.austenite_finish + _THROUGH, springs), longest_pulse(rig))
    steps = math.ceil(heating / _DT)
    on = np.concatenate([np.ones(steps), np.zeros(round(_LONGEST / _DT))])
    temperature = HeatModel([springs]).run(on[:, None], _DT).temperature[steps:, 0]
    goal = max(springs.martensite_finish - _THROUGH, springs.ambient + 0.5)
    cooled = np.flatnonzero(temperature < goal)
    cooling = _DT * (cooled[0] + 1) if len(cooled) else _LONGEST
    at_once = max(1, int((rig.supply.budget_a + 1e-9) // float(springs.current(0.0))))
    if rig.supply.outputs == "shared":
        at_once = 2 * motors
    rounds = math.ceil(2 * motors / at_once)  # every motor has a spring on both faces
    limits = rig.limits
    period = max(heating + max(cooling, limits.least_off_s), heating / limits.duty, rounds * heating)
    return round(period, 1), heating / round(period, 1)
