"""What scales and an ammeter add to a film."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.bench import AMMETER, Bench
from calibration.dynamics_problem import Problem
from calibration.individual import individual
from eldir.built import build
from eldir.knobs import KNOBS, QUANTITIES, specimen
from tests.dynamics_rigs import NOMINAL, hidden, walker


def test_readings_of_the_very_robot_are_not_off() -> None:
    body, truth = walker(), hidden(3)
    weight = float(build(body.morphology, truth[0]).masses.sum())
    one = individual(body.morphology, truth, (), ())
    assert Bench().off(body, one).shape == (0,)
    assert Bench(weight, truth[1].current_limit).off(body, one) == pytest.approx([0, 0], abs=1e-9)
    heavier = individual(body.morphology, truth, ("weight", "current"), [0.1, -0.02])
    assert Bench(weight, truth[1].current_limit).off(body, heavier) == pytest.approx([1, -1], abs=0.01)


def test_an_ammeter_tells_the_heat_capacity_as_well_as_resistance_is_known() -> None:
    """A film tells the square of the current by the heat capacity, times the resistance. With each normal,
    the heat's variance after a reading is in closed form."""
    names = tuple(KNOBS)
    fixed = np.array([0.0 if KNOBS[n].silent else 1e12 for n in names])  # by a film that tells all it can
    sds = {}
    for current in (None, 4.0):
        problem = Problem(
            walker(), [], NOMINAL, names, (1e-4, 1e-4), np.ones(len(names)), Bench(None, current)
        )
        known = problem.known_slopes(np.zeros(len(names)))
        left = np.linalg.inv(known.T @ known + np.diag(fixed))
        for name in ("heat_capacity", "cooling"):
            by = QUANTITIES[name].by(names)
            sds[name, current] = np.sqrt(by @ left @ by)
    heat, resistance = KNOBS["heat"].spread, KNOBS["resistance"].spread
    after = heat**2 - heat**4 / (heat**2 + resistance**2 + (2 * AMMETER) ** 2)
    for name in ("heat_capacity", "cooling"):
        assert sds[name, None] == pytest.approx(heat, rel=1e-3)
        assert sds[name, 4.0] == pytest.approx(np.sqrt(after), rel=1e-3)
    assert np.sqrt(after) == pytest.approx(0.018, rel=0.01)


def test_current_counts_also_where_the_voltage_is_what_limits() -> None:
    """The knobs scale the supply's limit and its voltage alike, so that a reading tells the same."""
    weak = (NOMINAL[0], replace(NOMINAL[1], current_limit=50.0))
    assert weak[1].current(0.0) < 20
    for name in ("current", "heat", "resistance"):
        up = specimen(weak, [name], [1.0])[1]
        by = dict(zip(KNOBS, QUANTITIES["current"].by(tuple(KNOBS)), strict=True))[name]
        assert np.log(up.current(0.0) / weak[1].current(0.0)) == pytest.approx(by, abs=1e-9)
