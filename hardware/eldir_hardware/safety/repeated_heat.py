"""Temperatures under switching that repeats, in the period after which they repeat too."""

from __future__ import annotations

import math

import numpy as np

from eldir.built.heat import HeatModel, SpringHistory, SpringState
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters

_SAME = 0.005  # change of a temperature over `_LEAST` that counts as none [K]
_LEAST = 15.0  # temperatures are compared after at least this time, however short a period [s]
_MOST = 500  # comparisons; still air needs dozens


def run_until_repeated(on: FloatArray, dt: float, springs: SpringParameters, ceiling: float) -> SpringHistory:
    """The first period, from cold, after which springs are above the ceiling [C], or else repeat.

    `on` (T, A): in which part of each step of `dt` seconds each spring is heated. Springs that start cold get
    hotter from period to period, so the last one has the peak.
    """
    model = HeatModel([springs] * on.shape[1])
    together = max(1, math.ceil(_LEAST / (len(on) * dt)))
    every = np.tile(on, (together, 1))
    state = SpringState.cold(on.shape[1], springs)
    for _ in range(_MOST):
        history = model.run(every, dt, state)
        change = float(abs(history.temperature[-1] - state.temperature).max())
        if change < _SAME or history.temperature.max() > ceiling + 5.0:
            break
        state = history.final
    last = (getattr(history, name)[-len(on) :] for name in ("temperature", "martensite", "length", "current"))
    return SpringHistory(*last)
