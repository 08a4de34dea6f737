"""Losses in still air: a textbook's example, another correlation, and the page that names a current."""

import re
from dataclasses import replace

import numpy as np
import pytest

from eldir.parameters.springs import (
    CORRELATION_ERROR,
    EMISSIVITY,
    SpringParameters,
    free_convection,
    max_still_air_temperature,
    min_heat_transfer_coefficient,
    radiation,
    wire_heat_transfer_coefficient,
)
from eldir_hardware.rig.supply import LimitError, steady_temperature_in_still_air
from eldir_hardware.safety import limits
from tests.hardware.rigs_and_schedules import measured, rig_with
from tests.hardware.safety.independent_heat import Wire, still_air, temperatures
from tests.paths import ROOT
from tests.raised import raises

WIRE = SpringParameters().with_resistance(0.987)


def test_a_steam_pipe_of_the_textbook():
    """Incropera and DeWitt, example 9.4: 0.1 m, 165 C in 23 C: 325 W/m convection, 441 radiation."""
    area, rise = np.pi * 0.1, 165 - 23
    assert free_convection(0.1, 165, 23) * area * rise == pytest.approx(325, rel=0.02)
    assert radiation(165, 23, 0.85) * area * rise == pytest.approx(441, rel=0.01)


def test_two_correlations_differ_by_no_more_than_the_scatter():
    for wire in (0.38e-3, 0.5e-3, 0.75e-3, 1e-3):
        other = still_air(wire, 22.0, EMISSIVITY)
        for surface in (40.0, 60.0, 90.0, 110.0):
            assert wire_heat_transfer_coefficient(wire, surface, 22.0) == pytest.approx(
                other(surface), rel=CORRELATION_ERROR
            )


def test_a_straight_wire_at_the_current_that_was_called_safe():
    """The outside study: 2.05 A for ever: 102 C; in air of 30 C with 5 % more resistance 112 C."""
    for ambient, ohm, expected in ((22.0, 0.987, 102), (30.0, 1.05 * 0.987, 112)):
        found = WIRE.ambient
        for _ in range(200):
            coefficient = wire_heat_transfer_coefficient(WIRE.wire_diameter, found, ambient)
            found = ambient + 2.05**2 * ohm / (coefficient * np.pi * WIRE.wire_diameter * WIRE.wire_length)
        assert found == pytest.approx(expected, abs=2.5)


def test_a_coil_loses_less_than_its_wire():
    """And what is counted on is less than both correlations give for the wire or for a closed cylinder."""
    for surface in (40.0, 60.0, 90.0):
        least = min_heat_transfer_coefficient(WIRE, surface)
        wire = still_air(WIRE.wire_diameter, 22.0, 0.0)(surface)
        outer = WIRE.coil_diameter + WIRE.wire_diameter
        cylinder = still_air(outer, 22.0, 0.0)(surface) * np.pi * outer * 0.040  # half extended: 40 mm
        assert least < wire / 2
        assert least * np.pi * WIRE.wire_diameter * WIRE.wire_length < cylinder


def test_the_settled_temperature_is_where_heat_and_loss_balance():
    power = 0.5
    settled = max_still_air_temperature(WIRE, power)
    surface = np.pi * WIRE.wire_diameter * WIRE.wire_length
    assert min_heat_transfer_coefficient(WIRE, settled) * surface * (settled - WIRE.ambient) == pytest.approx(
        power, rel=1e-3
    )
    assert max_still_air_temperature(replace(WIRE, ambient=30.0), power) > settled + 7


def test_the_current_in_docs_safety_is_safe_for_ever_and_the_next_is_not():
    page = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    (stated,) = re.findall(r"this current is\s+([\d.]+) A", page)

    def rig(current: float):
        return rig_with(supply={"current_limit_a": current}, cutoff=None, fan=None)

    limits.check_rig(rig(float(stated)))
    with raises(LimitError, "limit.stuck-contact"):
        limits.check_rig(rig(float(stated) + 0.05))
    # The second model, at the hottest air, greatest current and resistance, with what a closed coil loses.
    outer, length = 7.25e-3, 0.040
    other = still_air(outer, 30.0, 0.2)
    share = outer * length / (0.75e-3 * np.pi * 6.5e-3 * 26.7)
    wire = Wire(1.05 * float(stated), 1.05 * 0.987, 30.0, lambda t: 0.8 * other(t) * share)
    hot = temperatures(wire, [(0.0, 900.0)], 900.0)[-1]
    assert hot == pytest.approx(steady_temperature_in_still_air(rig(float(stated))), abs=6) and hot < 95


def test_a_measured_coefficient_replaces_the_correlation():
    rig = rig_with(
        springs=measured(convection_still=45.0), supply={"current_limit_a": 1.6}, cutoff=None, fan=None
    )
    limits.check_rig(rig)
    assert rig.spring_parameters().convection_still == 45.0
    assert rig_with(fan=None).spring_parameters().convection_still == pytest.approx(35, abs=0.5)
