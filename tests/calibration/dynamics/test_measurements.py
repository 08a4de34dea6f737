"""What scales, an ammeter and a voltmeter add to a film."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.robot import build
from eldir.parameters.robot import QUANTITIES, RobotParameters
from eldir.parameters.uncertain import PARAMETERS
from eldir_calibration.dynamics._problem import Problem
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.recording import Measurements
from tests.calibration.dynamics.hidden_rigs import NOMINAL, hidden, walker

METER = DEFAULT_CONFIG.meter_error


def test_readings_of_the_very_robot_are_not_off() -> None:
    body, truth = walker(), hidden(3)
    weight = float(build(body.morphology, truth).masses.sum())
    assert Measurements().residuals(body, truth).shape == (0,)
    voltage = truth.springs.current_limit * truth.springs.resistance
    read = Measurements(weight, truth.springs.current_limit, voltage)
    assert read.residuals(body, truth) == pytest.approx([0, 0, 0], abs=1e-9)
    heavier = truth.at(("weight", "current"), [0.1, -0.02])
    assert read.residuals(body, heavier) == pytest.approx([1, -1, -1], abs=0.01)
    resists = truth.at(("resistance",), [0.5])
    assert read.residuals(body, resists) == pytest.approx([0, -1, 1], abs=0.01)


def test_meters_tell_the_heat_capacity() -> None:
    """A film tells the square of the current by the heat capacity, times the resistance. All normal,
    what is left of the heat's after readings is in closed form."""
    names = tuple(PARAMETERS)
    # By a film that tells all it can.
    fixed = np.array([0.0 if PARAMETERS[n].unobservable else 1e12 for n in names])
    sds = {}
    across = 4.0 * NOMINAL.springs.resistance
    for read in (Measurements(), Measurements(current=4.0), Measurements(current=4.0, voltage=across)):
        problem = Problem(walker(), [], NOMINAL, names, (1e-4, 1e-4), np.ones(len(names)), read)
        known = problem.prior_jacobian(np.zeros(len(names)))
        left = np.linalg.inv(known.T @ known + np.diag(fixed))
        for name in ("heat_capacity", "cooling"):
            by = QUANTITIES[name].gradient(names)
            sds[name, read.current, read.voltage] = np.sqrt(by @ left @ by)
    heat, resistance = PARAMETERS["heat"].spread, PARAMETERS["resistance"].spread
    deviations = {(False, False): heat}
    # The film gives I^2 R / C; an ammeter then C / R, both meters C = I U / (I^2 R / C) beside.
    of_current = np.array([0.5, -0.5]) / METER
    of_voltage = np.array([0.5, 0.5]) / METER
    known = np.diag([heat**-2, resistance**-2]) + np.outer(of_current, of_current)
    deviations[True, False] = np.sqrt(np.linalg.inv(known)[0, 0])
    assert deviations[True, False] ** 2 == pytest.approx(
        heat**2 - heat**4 / (heat**2 + resistance**2 + (2 * METER) ** 2)
    )
    deviations[True, True] = np.sqrt(np.linalg.inv(known + np.outer(of_voltage, of_voltage))[0, 0])
    for (_, current, voltage), sd in sds.items():
        assert sd == pytest.approx(deviations[current is not None, voltage is not None], rel=1e-3)
    assert [round(1e3 * d) for d in deviations.values()] == [30, 18, 7]


@pytest.mark.parametrize(("error", "left"), [(0.005, 6.9), (0.0066, 8.9), (0.0095, 12.2)])
def test_a_worse_meter_tells_less(error: float, left: float) -> None:
    """Cooling by a current sensor: an INA226 and an INA3221, both on shunts of 1 %, beside a good meter."""
    names = tuple(PARAMETERS)
    fixed = np.array([0.0 if PARAMETERS[n].unobservable else 1e12 for n in names])
    across = 4.0 * NOMINAL.springs.resistance
    read = Measurements(current=4.0, voltage=across, error=error)
    problem = Problem(walker(), [], NOMINAL, names, (1e-4, 1e-4), np.ones(len(names)), read)
    known = problem.prior_jacobian(np.zeros(len(names)))
    by = QUANTITIES["cooling"].gradient(names)
    sd = float(np.sqrt(by @ np.linalg.inv(known.T @ known + np.diag(fixed)) @ by))
    assert 1e3 * sd == pytest.approx(left, abs=0.15)
    assert sd < 0.018, "better than an ammeter alone"


def test_current_counts_also_where_the_voltage_is_what_limits() -> None:
    """The parameters scale the supply's limit and its voltage alike, so that a reading tells the same."""
    weak = RobotParameters(springs=replace(NOMINAL.springs, current_limit=50.0))
    assert weak.springs.current(0.0) < 20
    for name in ("current", "heat", "resistance"):
        up = weak.at([name], [1.0]).springs
        by = dict(zip(PARAMETERS, QUANTITIES["current"].gradient(tuple(PARAMETERS)), strict=True))[name]
        assert np.log(up.current(0.0) / weak.springs.current(0.0)) == pytest.approx(by, abs=1e-9)
