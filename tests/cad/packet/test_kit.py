"""kit.pdf: ratings against arithmetic by hand, lists and pages against the wiring that they come from."""

import math
import re
from dataclasses import replace

import pytest

from eldir.design import Ballast, Variant
from eldir.parameters.springs import SpringParameters, max_still_air_temperature
from eldir.parameters.wiring import wiring
from eldir_cad.checks.buildability import check
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet._circuit import FUSES, Circuit, air_speed, awg
from eldir_cad.packet._kit import TEST_CURRENT, draw_kit, robot_mass
from eldir_cad.packet.manifest import make_content
from eldir_cad.packet.shopping import bench_items, circuits
from tests.cad.drawn_bodies import WHEEL, design

PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)
SPRINGS = SpringParameters()
CIRCUIT = Circuit(1, SPRINGS, 3.6)
LEAD = 210


@pytest.fixture(scope="module")
def robot():
    """A wheel with two motors, and the report of its filter."""
    drawn = design(*WHEEL, motors=(0, 4))
    report = check(drawn.morphology, SPEC, PRINTER)
    return make_content(drawn, report, SPEC, PRINTER)


@pytest.fixture(scope="module")
def pages(robot):
    return draw_kit(robot, wiring(2), LEAD)


def words(figures):
    texts = [text for page in figures for where in (page, *page.axes) for text in where.texts]
    return " ".join(" ".join(text.get_text() for text in texts).split())


def test_the_ratings_of_a_circuit_by_hand():
    """0.8 uOhm m x 545.2 mm / 0.4418 mm2 = 0.987 Ohm; with leads of 0.05 Ohm 3.6 A need 3.73 V of 11 V."""
    assert CIRCUIT.resistance == pytest.approx(0.9873, abs=1e-4)
    assert CIRCUIT.max_current == pytest.approx(3.78)
    assert CIRCUIT.fuse == 4.0
    assert CIRCUIT.lead_section == 0.5
    assert CIRCUIT.loaded_voltage == pytest.approx(3.6 * 1.0373, abs=1e-3)
    assert CIRCUIT.min_loaded_voltage == pytest.approx(0.95 * 3.6 * (0.95 * 0.9873 + 0.05), abs=1e-3)
    assert CIRCUIT.unlimited_current == pytest.approx(11 / 1.0373, abs=1e-3)
    assert CIRCUIT.ferrule == (1.0, 1.4)  # 0.942 mm2 of wires in 1.54 mm2
    assert [awg(section) for section in (0.5, 0.75, 1.5)] == [20, 18, 14]  # 0.519, 0.823 and 2.08 mm2
    two = replace(CIRCUIT, coils=2)
    assert two.fuse == CIRCUIT.fuse
    assert two.loaded_voltage - CIRCUIT.loaded_voltage == pytest.approx(3.6 * 0.9873, abs=1e-3)


@pytest.mark.parametrize("limit", [0.3, 0.7, 3.0, 3.6, 6.1, 30.0])
def test_a_fuse_carries_every_current_that_the_supply_allows_and_a_lead_carries_its_fuse(limit):
    circuit = replace(CIRCUIT, current_limit=limit)
    assert circuit.fuse >= 1.05 * limit - 1e-9
    assert max([0.0, *(f for f in FUSES if f < circuit.fuse)]) < 1.05 * limit - 1e-9
    assert circuit.fuse / circuit.lead_section <= 8.0


def test_the_air_of_the_fan_cools_as_predictions_have_it():
    """By the correlation of Churchill and Bernstein, 150 W/(m2 K) on a wire of 0.75 mm are a Nusselt number
    of 4.0 in air of 41 C, and a Reynolds number of about 62."""
    assert air_speed(SPRINGS) * 0.75e-3 / 17.2e-6 == pytest.approx(62, rel=0.05)


def test_a_coil_stays_cold_at_the_test_current():
    assert max_still_air_temperature(SPRINGS, TEST_CURRENT**2 * SPRINGS.resistance) < SPRINGS.austenite_start


def test_the_list_has_a_protected_output_for_each_channel(robot):
    items = {item.name: item for item in bench_items(robot, wiring(2), LEAD)}
    for name in ("supply_output", "timer_relay", "terminal"):
        assert items[name].count == 4
    assert items["fuse"].count == 8 and items["fuse"].purpose.startswith("4 A quick-acting")
    assert items["ferrule"].count == 8, "two for each coil"
    assert items["lead"].count == 6, "eight of 0.71 m"
    assert "4 channels or more" in items["relay_board"].purpose
    assert "3.4 to 11 V" in items["timer_relay"].purpose


def test_the_diagram_has_every_channel_once_with_its_coil(pages):
    (page,) = (page for page in pages if "Wiring diagram" in words([page]))
    shown = words([page])
    for connection in wiring(2):
        n = connection.channel
        assert shown.count(f"S{connection.spring} {connection.face}") == 1
        for sign in (f"F{n} 4 A F", f"T{n} 6.3 s", f"X{n}", f"{n}+", f"{n}-"):
            assert shown.count(sign) == 1, sign
    for sign in ("F: ", "K: ", "T: ", "X: ", "S: ", "crimp: "):
        assert sign in shown, "every sign is in the legend"


def test_a_channel_that_heats_both_coils_of_a_motor_has_them_in_one_row(robot):
    in_series = wiring(2, in_series=True)
    told = words(draw_kit(robot, in_series, LEAD))
    assert told.count("1.97 Ohm in series, 7.3 V") == 2
    assert told.count("S0 front") == told.count("S0 back") == 2, "in the diagram and in the record"
    assert "differ by" not in told, "one output, one current"
    items = {item.name: item for item in bench_items(robot, in_series, LEAD)}
    assert [items[name].count for name in ("supply_output", "fuse", "terminal")] == [2, 4, 2]
    assert items["ferrule"].count == 8 + 2, "two at each coil, one between two coils"
    assert items["lead"].count == math.ceil(8 * 0.21 + 4 * 0.5)
    assert "wire-wound, 2 Ohm" in items["test_resistor"].purpose
    assert "6.6 to 11 V" in items["timer_relay"].purpose  # 3.42 A x (2 x 0.938 + 0.05) Ohm


def test_the_pages_give_the_mass_of_the_filter_and_the_bounds_of_the_meter(robot, pages):
    told = words(pages)
    mass = float(re.search(r"Mass of the robot: ([\d.]+) g", told).group(1))
    assert mass == pytest.approx(robot.report.figures["robot_g"], abs=0.02)
    assert "281 to 311 mV (0.94 to 1.04 Ohm)" in told  # 0.3 A x 0.987 Ohm, 5 % to either side
    assert "settles at 35 C at most" in told
    assert told.count("S0 front") == 2, "in the diagram and in the record"


def test_coils_are_measured_and_chosen_before_the_robot_is_built(pages):
    told = words(pages)
    order = ["Measure the resistance", "switched off; then with", "The two most alike", "Build the robot"]
    assert sorted(order, key=told.index) == order
    assert "nearest to each other belong to a motor" in told
    assert told.count("cold [mm]") == told.count("hot [mm]") == 1


def test_the_robots_mass_has_its_ballast():
    drawn = design(*WHEEL, motors=(0, 4))
    report = check(drawn.morphology, SPEC, PRINTER)
    loaded = make_content(replace(drawn, variant=Variant(None, Ballast(11.0, 6))), report, SPEC, PRINTER)
    assert robot_mass(loaded) == pytest.approx(report.figures["robot_g"] + 11.0, abs=0.03)


def test_a_lower_current_needs_a_smaller_fuse_everywhere(robot):
    low = robot.spec.model_copy(update={"coil": robot.spec.coil.model_copy(update={"current_limit_a": 2.9})})
    content = replace(robot, spec=low)
    assert {circuit.fuse for circuit in circuits(content, wiring(2)).values()} == {3.15}
    told = words(draw_kit(content, wiring(2), LEAD))
    assert "3.15 A quick-acting" in told and "F1 3.15 A F" in told and "F 3.15 A" in told
    assert "3.6 A" not in told
