"""Heat of springs alone and together, against Ohm's law written out here."""

from dataclasses import fields, replace

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from eldir.parameters.springs import forced_convection, min_heat_transfer_coefficient
from eldir_app.commands.rig import rig as rig_commands
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import (
    LimitError,
    check_current,
    coldest_springs,
    find_implausible_springs,
    power_shares,
    scale_by_shares,
    springs_at_tolerances,
    steady_temperature_in_still_air,
    worst_springs,
)
from eldir_hardware.safety.limits import check_schedule
from tests.hardware.rigs_and_schedules import SCHEDULE, measured, rig_with
from tests.raised import raises

HOT = 0.0  # martensite fraction


V, MORE = 11.0, 1.05
"""Voltage of the supply, and the greatest tolerated current as a part of the one in the rig file."""


def rig_of(outputs: str = "each", **supply: object) -> Rig:
    """Stiff contacts, so that only the supply limits."""
    values = {"current_limit_a": 4.0, "max_total_current_a": 400.0, "outputs": outputs} | supply
    return rig_with(supply=values, board={"contact_rating_a": 100.0})


# The worst springs.


@pytest.mark.parametrize(
    ("entry", "name"),
    [
        ({"springs": {"resistance_ohm": None}}, "springs.resistance_ohm"),
        ({"supply": {"current_limit_a": None}}, "supply.current_limit_a"),
    ],
)
def test_without_measurements_nothing_is_predicted(entry, name):
    for springs in (worst_springs, coldest_springs):
        with raises(LimitError, "limit.not-measured", name):
            springs(rig_with(**entry))


@pytest.mark.parametrize(("current", "less_heats_more"), [(4.0, False), (30.0, True)])
def test_the_two_corners_of_the_tolerances(current, less_heats_more):
    """Every tolerance in the direction that heats, and in the other one."""
    rig = rig_with(
        tolerances={
            "current": 0.08,
            "ambient_min_c": 16.0,
            "ambient_max_c": 33.0,
            "convection_tolerance": 0.2,
        },
        springs=measured(convection_fan=160.0, convection_still=30.0),
        supply={"current_limit_a": current},
    )
    worst, coldest = worst_springs(rig), coldest_springs(rig)
    assert (worst.ambient, coldest.ambient) == (33.0, 16.0)
    assert (worst.supply_voltage, coldest.supply_voltage) == pytest.approx((11.88, 10.12))
    assert (worst.current_limit, coldest.current_limit) == pytest.approx((1.08 * current, 0.92 * current))
    assert (worst.convection_fan, coldest.convection_fan) == pytest.approx((128.0, 192.0))
    assert (worst.convection_still, coldest.convection_still) == pytest.approx((24.0, 36.0))
    factors = (0.95, 1.05) if less_heats_more else (1.05, 0.95)
    assert (worst.resistance, coldest.resistance) == pytest.approx([0.987 * f for f in factors])


def test_springs_on_a_rig_that_is_off_by_a_part_of_its_tolerances():
    rig = rig_with(tolerances={"current": 0.1, "ambient_min_c": 10.0, "convection_tolerance": 0.2})
    nominal = replace(rig.spring_parameters(), ambient=20.0)
    assert springs_at_tolerances(rig, nominal) == nominal
    off = springs_at_tolerances(rig, nominal, current=0.5, convection=-1.0, room=-0.5)
    assert off.ambient == pytest.approx(15.0)
    assert springs_at_tolerances(rig, nominal, room=0.5).ambient == pytest.approx(
        25.0
    )  # half of the way to 30
    for name, factor in (
        ("current_limit", 1.05),
        ("supply_voltage", 1.05),
        ("convection_fan", 0.8),
        ("convection_still", 0.8),
    ):
        assert getattr(off, name) == pytest.approx(factor * getattr(nominal, name))
    kept = {"ambient", "current_limit", "supply_voltage", "convection_fan", "convection_still"}
    assert {f.name for f in fields(off) if getattr(off, f.name) != getattr(nominal, f.name)} == kept


def test_still_air_that_was_not_measured_takes_the_least_heat():
    """From 10 K above the hottest air on: hotter springs lose more."""
    worst = worst_springs(rig_with())
    assert worst.convection_still == pytest.approx(min_heat_transfer_coefficient(worst, 40.0))
    assert worst.convection_still < min_heat_transfer_coefficient(worst, 60.0)


@pytest.mark.parametrize("current", [1.0, 4.0, 8.0, 10.0, 10.4, 10.6, 10.8, 11.2, 12.0, 30.0])
@pytest.mark.parametrize("tolerance", [0.01, 0.05, 0.3])
def test_no_spring_within_the_tolerance_is_heated_more(current, tolerance):
    """On the limit of current more resistance is more heat, below it less; in between lies the worst. All of
    it at the greatest tolerated current."""
    rig = rig_with(supply={"current_limit_a": current}, springs={"resistance_tolerance": tolerance})
    nominal, worst = rig.spring_parameters(), float(worst_springs(rig).power(HOT))
    factors = np.linspace(1 - tolerance, 1 + tolerance, 401)
    heats = []
    for factor in factors:
        hot = float(nominal.with_resistance(factor * nominal.resistance).resistance_at(HOT))
        flowing = min(MORE * current, MORE * V / (hot + 0.05))
        heats.append(flowing**2 * hot)
    assert worst >= max(heats) * (1 - 1e-9)
    assert abs(float(worst_springs(rig).resistance) / nominal.resistance - 1.0) <= tolerance + 1e-9


@pytest.mark.parametrize(
    ("fan", "blows"), [(None, False), ({"interlocked": False}, False), ({"interlocked": True}, True)]
)
def test_a_fan_counts_only_if_hardware_cuts_the_supply_without_it(fan, blows):
    assert worst_springs(Rig.from_json(rig_with().model_dump() | {"fan": fan})).fan is blows


# Shares.


def test_with_an_output_for_each_every_spring_has_its_own_heat():
    rig = rig_of("each")
    assert power_shares(rig, rig.spring_parameters()).tolist() == [1.0] * 5
    assert power_shares(rig, worst_springs(rig), worst=True).tolist() == [1.0] * 5


@pytest.mark.parametrize("current", [2.0, 4.0, 20.0, 48.0])
def test_equal_springs_on_one_output_share_its_current(current):
    """By Ohm's law: n springs in parallel draw at most the limit, each an n-th of it."""
    rig = rig_of("shared", current_limit_a=current)
    springs = rig.spring_parameters()
    resistance, lead = float(springs.resistance), 0.05
    alone = float(springs.power(HOT))
    for n, part in enumerate(power_shares(rig, springs)):
        flowing = min(V / (resistance + lead), current / max(n, 1))
        assert part == pytest.approx(min(flowing**2 * resistance / alone, 1.0), rel=1e-6)


def test_springs_that_the_voltage_limits_take_their_whole_heat_together():
    """Of small resistance: two draw less than the supply's limit, three more."""
    rig = rig_with(
        supply={"current_limit_a": 48.0, "max_total_current_a": 400.0, "outputs": "shared"},
        springs={"resistance_ohm": 0.6},
        board={"contact_rating_a": 100.0},
    )
    flowing = V / (0.6 + 0.05)
    parts = power_shares(rig, rig.spring_parameters())
    assert parts[:4] == pytest.approx([1.0, 1.0, 1.0, (16.0 / flowing) ** 2])


@pytest.mark.parametrize("current", [4.0, 20.0, 48.0])
def test_the_worst_spring_draws_more_than_the_others(current):
    """Within the tolerance: it has one end of it, the others the largest resistance; by Ohm's law."""
    rig = rig_of("shared", current_limit_a=current)
    worst = worst_springs(rig)
    alone, lead = float(worst.power(HOT)), 0.05
    nominal = float(rig.spring_parameters().resistance)
    others = 1.05 * nominal
    for n, part in enumerate(power_shares(rig, worst, worst=True)):
        if n == 0:
            assert part == 1.0
            continue
        heats = []
        for own in np.linspace(0.95 * nominal, 1.05 * nominal, 201):
            voltage = MORE * min(V, current / (1 / (own + lead) + (n - 1) / (others + lead)))
            heats.append((voltage / (own + lead)) ** 2 * own)
        assert part == pytest.approx(min(max(heats) / alone, 1.0), rel=2e-3)
        assert part >= power_shares(rig, rig.spring_parameters())[n] * float(
            rig.spring_parameters().power(HOT)
        ) / alone * (1 - 1e-9)


def test_what_is_closed_for_a_whole_step_takes_its_share():
    on = np.array([[1.0, 1.0, 0.0], [1.0, 0.5, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]])
    parts = [1.0, 0.9, 0.4, 0.2]
    expected = [[0.4, 0.4, 0.0], [0.9, 0.45, 0.0], [0.2, 0.2, 0.2], [0.0, 0.0, 0.0], [0.27, 0.0, 0.0]]
    assert scale_by_shares(on, parts) == pytest.approx(np.array(expected))
    assert scale_by_shares(on - 1e-12, parts)[0] == pytest.approx([0.4, 0.4, 0.0]), "rounded"


# Current.


@pytest.mark.parametrize(("together", "allowed"), [(1, True), (4, True), (5, False)])
def test_the_budget_of_all_outputs(together, allowed):
    """Each of 4 A carries at most 4.2 A within the tolerance."""
    rig = rig_of("each", max_total_current_a=16.8)
    if allowed:
        check_current(rig, together)
    else:
        with raises(LimitError, "limit.supply", match="at most 16.8 A; found 5 x 4.2 A"):
            check_current(rig, together)


@pytest.mark.parametrize(("budget", "allowed"), [(4.2, True), (4.19, False)])
def test_the_budget_of_a_shared_output(budget, allowed):
    """Its limit holds for all springs together."""
    rig = rig_of("shared", max_total_current_a=budget)
    check_current(rig, 0)
    if allowed:
        check_current(rig, 4)
    else:
        with raises(LimitError, "limit.supply"):
            check_current(rig, 4)


@pytest.mark.parametrize(("rating", "allowed"), [(4.2, True), (4.19, False)])
def test_what_a_contact_may_carry(rating, allowed):
    """A current limit of 4 A may be 4.2 A within the tolerance."""
    rig = rig_with(board={"contact_rating_a": rating}, supply={"current_limit_a": 4.0})
    if allowed:
        check_current(rig, 1)
    else:
        with raises(LimitError, "limit.contact-rating", match="at most 4.19 A; found 4.2 A"):
            check_current(rig, 1)


# Thermal constants that nobody measured.

HOPEFUL = {
    "heat_capacity": 1000.0,
    "latent_heat": 40_000.0,
    "convection_fan": 600.0,
    "convection_still": 100.0,
}


def test_values_that_nobody_measured_make_no_schedule_cooler():
    """They did by 37 K. Those that a calibration wrote count, until somebody edits one."""
    usual = check_schedule(SCHEDULE, rig_with())
    assert check_schedule(SCHEDULE, rig_with(springs=HOPEFUL)) == usual
    calibrated = measured(**HOPEFUL)
    cooler = check_schedule(SCHEDULE, rig_with(springs=calibrated))
    assert cooler.peak_c < 55 < usual.peak_c
    for name, value in HOPEFUL.items():
        edited = rig_with(springs=calibrated | {name: 0.99 * value})
        assert not edited.springs.calibrated and check_schedule(SCHEDULE, edited) == usual
    part = measured(heat_capacity=1000.0) | {"latent_heat": 40_000.0, "convection_fan": 600.0}
    rig = rig_with(springs=part)
    assert rig.springs.calibrated == {"heat_capacity"}
    assert cooler.peak_c + 5 < check_schedule(SCHEDULE, rig).peak_c < usual.peak_c - 5


def test_values_that_make_springs_hotter_count_whoever_wrote_them():
    usual = worst_springs(rig_with())
    hotter = {"heat_capacity": 400.0, "latent_heat": 9000.0, "convection_fan": 100.0, "convection_still": 4.0}
    for springs in (hotter, measured(**hotter)):
        worst = worst_springs(rig_with(springs=springs))
        assert (worst.heat_capacity, worst.latent_heat) == (400.0, 9000.0)
        assert (worst.convection_fan, worst.convection_still) == pytest.approx((90.0, 3.6))
    assert (usual.heat_capacity, usual.latent_heat) == (466.0, 12_200.0)
    assert usual.convection_fan == pytest.approx(135.0)


THICK = {"wire_diameter_mm": 1.5, "coil_diameter_mm": 13.0, "turns": 13.0, "resistance_ohm": 0.2403}


def test_the_fan_cools_a_thicker_wire_less():
    """Across a stream the coefficient falls about as d to the power of -1/2 (Hilpert 1933: -0.534 here)."""
    fans = [
        rig_with(springs={"wire_diameter_mm": d, "resistance_ohm": None}).spring_parameters().convection_fan
        for d in (0.375, 0.75, 1.5)
    ]
    assert fans[1] == 150.0
    assert np.log2(fans[0] / fans[1]) == pytest.approx(0.534, abs=0.03)
    assert np.log2(fans[1] / fans[2]) == pytest.approx(0.534, abs=0.03)
    thin = rig_with(springs={"wire_diameter_mm": 0.5, "resistance_ohm": None}).spring_parameters()
    assert round(thin.convection_fan) == 187  # docs/reference/rig.md
    for written, counts in ((None, 104.2), (150.0, 104.2), (90.0, 90.0)):
        worst = worst_springs(rig_with(springs=THICK | {"convection_fan": written}))
        assert worst.convection_fan == pytest.approx(0.9 * counts, rel=0.01)


@pytest.mark.parametrize(("still", "hotter"), [(100.0, False), (12.0, False), (3.0, True)])
def test_still_air_that_a_person_wrote_protects_no_welded_contact(still, hotter):
    """A spring that stays on settles where the computed least loss says, or hotter."""
    supply = {"current_limit_a": 0.6}
    computed = steady_temperature_in_still_air(rig_with(fan=None, supply=supply))
    written = steady_temperature_in_still_air(
        rig_with(fan=None, supply=supply, springs={"convection_still": still})
    )
    assert written > computed + 20 if hotter else written == computed
    believed = rig_with(fan=None, supply=supply, springs=measured(convection_still=still))
    assert steady_temperature_in_still_air(believed) == pytest.approx(
        worst_springs(believed).steady_temperature
    )


def test_a_constant_outside_what_is_published_is_named_with_its_range():
    assert (
        find_implausible_springs(rig_with())
        == find_implausible_springs(rig_with(springs={"convection_still": 35.0}))
        == {}
    )
    inside = {"heat_capacity": 837.0, "latent_heat": 24_200.0, "convection_fan": 250.0}
    assert find_implausible_springs(rig_with(springs=inside)) == {}
    found = find_implausible_springs(rig_with(springs=HOPEFUL))
    assert found.keys() == HOPEFUL.keys()
    assert found["heat_capacity"] == (
        "springs.heat_capacity is implausible: expected 466 to 837 J/(kg K), found 1000 (not measured); "
        "measure it: eldir calibrate springs"
    )
    assert "expected 12200 to 24200 J/kg, found 40000" in found["latent_heat"]
    assert find_implausible_springs(rig_with(springs={"heat_capacity": 465.0})).keys() == {"heat_capacity"}
    told = find_implausible_springs(rig_with(springs=measured(heat_capacity=870.0)))["heat_capacity"]
    assert "(as eldir calibrate springs measured)" in told


def test_a_stream_takes_as_much_heat_as_published_tables_say():
    """Wire of 0.75 mm at 90 C in air of 22 C and 5 m/s, by Hilpert's power law (1933) for Re 40 to 4000."""
    conductivity, viscosity, prandtl = 0.0286, 18.7e-6, 0.703  # at 56 C
    reynolds = 5.0 * 0.75e-3 / viscosity
    hilpert = 0.683 * reynolds**0.466 * prandtl ** (1 / 3) * conductivity / 0.75e-3
    assert forced_convection(0.75e-3, 5.0, 90.0, 22.0) == pytest.approx(hilpert, rel=0.1)


def test_the_doctor_and_the_commands_name_it(tmp_path):
    values = rig_with(springs=HOPEFUL).model_dump(mode="json", exclude_none=True)
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(values))
    result = CliRunner().invoke(rig_commands, ["doctor", "--rig", str(path)])
    assert result.exit_code == 1 and "FAIL  springs: springs.heat_capacity is implausible" in result.output
    schedule = tmp_path / "schedule.json"
    SCHEDULE.save(schedule)
    result = CliRunner().invoke(
        rig_commands, ["drive", str(schedule), "--rig", str(path), "--log", str(tmp_path / "log.mcap")]
    )
    for name in HOPEFUL:
        assert f"warning: springs.{name} is implausible" in result.output
