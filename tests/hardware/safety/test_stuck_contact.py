"""Layer 0, value by value: which boards and cut-offs make a welded contact harmless."""

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.heat import HeatModel, SpringState
from eldir.parameters.springs import min_heat_transfer_coefficient
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError, worst_springs
from eldir_hardware.safety.worst_heat import check_board, stuck_temperature
from tests.hardware.rigs_and_schedules import measured, rig_with
from tests.raised import raises

TIMED = {"kind": "modbus", "channels": 5}
MEASURED = measured(convection_still=60.0)
"""Heat transfer in still air, as measured [W/(m2 K)]."""


def rig_of(cutoff: dict | None = None, **entries: object) -> Rig:
    return Rig.from_json(rig_with(**entries).model_dump() | {"cutoff": cutoff})


@pytest.mark.parametrize(
    ("board", "cutoff", "code"),
    [
        ({"kind": "lcus"}, None, None),
        (TIMED | {"retriggerable": True}, None, None),
        (TIMED | {"retriggerable": False}, None, None),
        (TIMED, None, "limit.unknown-timer"),
        (TIMED | {"retriggerable": True}, "contactor", None),
        (TIMED | {"retriggerable": False}, "contactor", "limit.contactor-stays-closed"),
        ({"kind": "lcus", "channels": 5}, "contactor", "limit.contactor-stays-closed"),
        (
            {"kind": "lcus", "channels": 5, "retriggerable": True},
            "contactor",
            "limit.contactor-stays-closed",
        ),
    ],
)
def test_boards_that_may_drive(board, cutoff, code):
    rig = rig_of({"kind": "contactor", "channel": 5} if cutoff else None, board=board)
    if code is None:
        check_board(rig)
    else:
        with raises(LimitError, code):
            check_board(rig)


def steady(rig: Rig) -> float:
    """Where the worst spring settles in still air, by the heat model held on for an hour [C]."""
    nominal = rig.spring_parameters(fan=False).with_resistance(float(worst_springs(rig).resistance))
    measured = rig.springs.convection_still
    assert measured is not None
    still = replace(
        nominal,
        ambient=30.0,
        current_limit=1.05 * nominal.current_limit,
        supply_voltage=1.05 * nominal.supply_voltage,
        convection_still=0.9 * measured,
    )
    return float(HeatModel([still]).run(np.ones((7200, 1)), 0.5).temperature.max())


@pytest.mark.parametrize("current", [1.0, 1.6, 1.9])
@pytest.mark.parametrize("cutoff", [None, {"kind": "thermal", "opens_at_c": 95.0}])
def test_a_current_that_is_safe_for_ever_needs_nothing(current, cutoff):
    """The fan that the rig has does not count."""
    rig = rig_of(cutoff, supply={"current_limit_a": current}, springs=MEASURED)
    hot = stuck_temperature(rig, worst_springs(rig), None)
    assert hot == pytest.approx(steady(rig), abs=0.05) and hot < 90


@pytest.mark.parametrize("current", [0.3, 0.5, 0.7])
def test_a_coefficient_that_was_not_measured_is_the_least_of_a_coil(current):
    """Held on at the coefficient that belongs to the temperature, the spring stays at this temperature."""
    rig = rig_of(None, supply={"current_limit_a": current})
    worst = worst_springs(rig)
    hot = stuck_temperature(rig, worst, None)
    still = replace(worst, fan=False, convection_still=min_heat_transfer_coefficient(worst, hot))
    held = HeatModel([still]).run(np.ones((7200, 1)), 2.0).temperature[-1, 0]
    assert hot == pytest.approx(held, abs=0.1) and 35 < hot < 90


@pytest.mark.parametrize(("above", "safe"), [(0.1, True), (-0.1, False)])
def test_the_ceiling_of_a_spring_that_stays_on(above, safe):
    rig = rig_of(None, supply={"current_limit_a": 1.8}, springs=MEASURED)
    settles = steady(rig)
    limits = rig.limits.model_copy(update={"max_temperature_c": settles + above})
    rig = rig.model_copy(update={"limits": limits})
    if safe:
        assert stuck_temperature(rig, worst_springs(rig), None) == pytest.approx(settles, abs=0.05)
    else:
        with raises(LimitError, "limit.stuck-contact", match="in still air"):
            stuck_temperature(rig, worst_springs(rig), None)


@pytest.mark.parametrize("cutoff", [None, "timer", "contactor"])
def test_a_temperature_of_exactly_the_ceiling_is_allowed(cutoff):
    rig, any_on = rig_of(None, supply={"current_limit_a": 1.8}, springs=MEASURED), None
    if cutoff == "timer":
        rig = rig_of({"kind": "timer", "max_on_s": 6.0})
    if cutoff == "contactor":
        rig = rig_of({"kind": "contactor", "channel": 5}, board=TIMED | {"retriggerable": True})
        any_on = (np.arange(400) * 0.05 < 5.0).astype(float)
    worst = worst_springs(rig)
    hot = stuck_temperature(rig, worst, None, any_on)
    limits = rig.limits.model_copy(update={"max_temperature_c": hot})
    assert stuck_temperature(rig.model_copy(update={"limits": limits}), worst, None, any_on) == hot


@pytest.mark.parametrize(("opens", "accepted"), [(89.9, True), (90.0, True), (90.1, False)])
def test_thermal_switches(opens, accepted):
    rig = rig_of({"kind": "thermal", "opens_at_c": opens})
    if accepted:
        assert stuck_temperature(rig, worst_springs(rig), None) == opens
    else:
        with raises(LimitError, "limit.stuck-contact", match="thermal switches"):
            stuck_temperature(rig, worst_springs(rig), None)


@pytest.mark.parametrize("seconds", [3.0, 5.02, 6.3])
def test_a_timer_from_the_hottest_of_all_starts(seconds):
    """Of several springs the one that is hottest when its contact welds."""
    rig = rig_of({"kind": "timer", "max_on_s": seconds}, supply={"current_limit_a": 3.4})
    worst = worst_springs(rig)
    starts = SpringState(np.array([30.0, 41.0, 22.0]), np.ones(3))
    one = SpringState(np.array([41.0]), np.ones(1))
    held = HeatModel([worst]).run(np.ones((round(seconds / 0.01), 1)), 0.01, one).temperature.max()
    assert stuck_temperature(rig, worst, starts) == pytest.approx(held, abs=0.6)
    assert stuck_temperature(rig, worst, starts) >= held - 0.05, "rather a step too long than too short"


def test_a_timer_that_acts_too_late():
    rig = rig_of({"kind": "timer", "max_on_s": 6.3})
    worst = worst_springs(rig)
    assert stuck_temperature(rig, worst, None) < 90
    with raises(LimitError, "limit.stuck-contact", match=r"found 1?[0-9.]+ C after 6.3 s"):
        stuck_temperature(rig, worst, SpringState(np.array([22.0, 62.0]), np.array([1.0, 0.0])))


@pytest.mark.parametrize(("seconds", "accepted"), [(5.0, True), (12.0, False)])
def test_a_contactor_that_others_keep_closed(seconds, accepted):
    rig = rig_of({"kind": "contactor", "channel": 5}, board=TIMED | {"retriggerable": True})
    worst = worst_springs(rig)
    any_on = (np.arange(600) * 0.05 < seconds).astype(float)
    held = HeatModel([worst]).run(np.tile(any_on, 8)[:, None], 0.05).temperature.max()  # until it repeats
    assert bool(held < 90) is accepted
    if accepted:
        assert stuck_temperature(rig, worst, None, any_on) == pytest.approx(held, abs=0.02)
    else:
        with raises(LimitError, "limit.stuck-contact", match="contactor"):
            stuck_temperature(rig, worst, None, any_on)
