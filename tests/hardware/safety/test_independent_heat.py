"""The independent thermal model on contact edges of real runs. `make stress` has more of them."""

import math

import numpy as np
import pytest

from eldir.built.heat import heat
from eldir_hardware.rig.supply import worst_springs
from eldir_hardware.safety import limits
from eldir_hardware.schedule import ActuationSchedule
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.safety.independent_heat import Wire, temperatures
from tests.hardware.safety.replayed_heat import HOTTEST, NOMINAL, peak, recorded_pulses, welded, wire
from tests.paths import DATA

GAITS = sorted((DATA / "gaits").glob("*.json"))
RIG = rig_with()
LATE = 0.25
"""Numerical error of both models together [K]."""


def test_the_independent_model_has_the_closed_form_of_a_wire_without_transformation():
    spring = Wire(2.0, 1.0, 20.0, lambda surface: 100.0, latent_heat=0.0)
    loss = 100.0 * math.pi * spring.diameter * spring.length
    mass = spring.density * math.pi / 4 * spring.diameter**2 * spring.length
    t = 0.01 * np.arange(1, 1001)
    exact = 20.0 + 4.0 / loss * (1 - np.exp(-loss / (mass * spring.heat_capacity) * t))
    assert np.abs(np.array(temperatures(spring, [(0.0, 10.0)], 10.0)) - exact).max() < 1e-6


def test_both_models_agree_in_the_worst_corner():
    """They share no code: the program's peak is the second model's."""
    worst = worst_springs(RIG)
    t = 0.01 * np.arange(6000)
    on = ((t % 20.0) >= 3.0) & ((t % 20.0) < 9.0)
    mine = heat(on[:, None].astype(float), 0.01, worst).temperature[:, 0]
    other = temperatures(wire(RIG, HOTTEST), [(3.0 + 20 * k, 9.0 + 20 * k) for k in range(3)], 60.0)
    assert np.abs(mine - other).max() < LATE


@pytest.mark.parametrize(
    "file",
    [
        pytest.param(f, id=f.stem, marks=[] if i in (0, 3) else pytest.mark.stress)
        for i, f in enumerate(GAITS)
    ],
)
def test_recorded_edges_of_five_designs_stay_below_the_ceiling(file):
    """In the worst corner, and with a contact that welds in the last pulse; nominal springs move."""
    schedule = ActuationSchedule.load(file)
    predicted = limits.check_schedule(schedule, RIG)
    pulses = recorded_pulses(schedule, RIG)
    hottest, stuck = (peak(p, wire(RIG, HOTTEST)) for p in (pulses, welded(pulses, RIG)))
    nominal = peak(pulses, wire(RIG, NOMINAL))
    print(
        f"\n{file.stem}: worst corner {hottest:.1f} C, contact welded {stuck:.1f} C, nominal {nominal:.1f} C"
    )
    assert hottest <= 90 and stuck <= 90
    assert hottest <= predicted.peak_c + LATE and stuck <= predicted.stuck_c + LATE
    assert nominal > 55, "most of the stroke: transformation ends at 60 C"


def test_the_former_limits_did_not_hold():
    """4 A, 6 s in 20 s: what version 0.1.0 allowed, in the same corner."""
    former = rig_with(supply={"current_limit_a": 4.0})
    pulses = {1: [(3.0 + 20 * k, 9.0 + 20 * k) for k in range(3)]}
    assert peak(pulses, wire(former, HOTTEST)) > 105
    assert peak(welded(pulses, RIG), wire(former, HOTTEST)) > 108


def test_a_tenth_of_the_coefficient_is_a_fifth_of_the_air_speed():
    """Churchill and Bernstein (1977) for a cylinder in cross flow of air at 45 C, wire of 0.75 mm."""
    diameter, conductivity, viscosity, prandtl = 0.75e-3, 0.0276, 17.6e-6, 0.705

    def coefficient(speed: float) -> float:
        reynolds = speed * diameter / viscosity
        shape = 0.62 * reynolds**0.5 * prandtl ** (1 / 3) / (1 + (0.4 / prandtl) ** (2 / 3)) ** 0.25
        return (0.3 + shape * (1 + (reynolds / 282_000) ** 0.625) ** 0.8) * conductivity / diameter

    speed = np.interp(150.0, [coefficient(v) for v in np.linspace(0.3, 5, 400)],
                      np.linspace(0.3, 5, 400))  # fmt: skip
    assert 1.0 < speed < 2.0, "the default is this air speed [m/s]"
    assert coefficient(0.8 * speed) >= (1 - RIG.tolerances.convection_tolerance) * coefficient(speed) * 0.99
