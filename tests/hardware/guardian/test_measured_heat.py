"""What the guardian concludes from measured currents: each row of the table, without any device."""

import pytest

from eldir_hardware.current_sensor import Measurement
from eldir_hardware.guardian.measured_heat import CurrentFlowsError, MeasuredHeat, UnexpectedHeatError
from eldir_hardware.rig.supply import LimitError
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

FOUR = {"current_limit_a": 4.0}
RIG = rig_with(sensor={"kind": "ina226"}, supply=FOUR)  # 4 A, at most 5 % more; 0.987 Ohm, 11 V
HOT = (4.0, 3.95)
OPEN = (0.0, 0.0)


def measured(began=10.0, saturated=(), **channels):
    """`c1=(amperes, volts)` and so on; the others carry nothing."""
    values = {c: channels.get(f"c{c}", OPEN) for c in (1, 2, 3, 4)}
    currents, volts = ({c: v[i] for c, v in values.items()} for i in (0, 1))
    return Measurement(began, currents, volts, frozenset(saturated))


def watch(closed=(1,), since=0.0, rig=RIG):
    heat = MeasuredHeat(rig, rig.sensor)
    heat.record_switching(dict.fromkeys(closed, True), since)
    return heat


ROWS = {
    "as ordered": ((1,), {"c1": HOT}, None, ""),
    "all open": ((), {}, None, ""),
    "noise where open": ((), {"c2": (0.009, 0.02)}, None, ""),
    "a drop along shared leads": ((1,), {"c1": HOT, "c2": (0.0, 2.7)}, None, ""),
    "welded": ((1,), {"c1": HOT, "c2": HOT}, CurrentFlowsError, "current flows in channel 2 although"),
    "half welded": ((), {"c3": (0.011, 0.0)}, CurrentFlowsError, "current flows in channel 3 although"),
    "backwards where open": ((), {"c3": (-1.0, 0.0)}, CurrentFlowsError, "current flows in channel 3"),
    "welded, lead broken": ((), {"c4": (0.0, 11.0)}, CurrentFlowsError, "there is voltage at channel 4"),
    "welded beats broken": (
        (1,),
        {"c1": (0.0, 11.0), "c2": HOT},
        CurrentFlowsError,
        "current flows in channel 2",
    ),
    "broken lead": (
        (1,),
        {"c1": (0.0, 11.0)},
        UnexpectedHeatError,
        "no current.*channel 1.*a lead of it, is broken",
    ),
    "supply off all the time": ((1, 2), {}, None, ""),
    "one output off": (
        (1, 2),
        {"c1": HOT},
        UnexpectedHeatError,
        "no current flows in channel 2.*is the supply on",
    ),
    "shunt backwards": ((1,), {"c1": (-4.0, 3.9)}, UnexpectedHeatError, "flows backwards in channel 1.*swap"),
    "limit, just": ((1,), {"c1": (4.24, 4.15)}, None, ""),
    "above the limit": ((1,), {"c1": (4.26, 4.15)}, UnexpectedHeatError, "too much current.*at most 4.25 A"),
    "voltage too high": (
        (1,),
        {"c1": (4.0, 12.3)},
        UnexpectedHeatError,
        "implausible voltage of channel 1",
    ),
    "voltage reversed": (
        (1,),
        {"c1": (4.0, -3.9)},
        UnexpectedHeatError,
        "implausible voltage of channel 1",
    ),
    "warm, 18 % more": ((1,), {"c1": (4.0, 4.66)}, None, ""),
    "hot clamp": (
        (1,),
        {"c1": (4.0, 4.90)},
        UnexpectedHeatError,
        "unexpected resistance.*0.77 to 1.20 Ohm; found 1.2[23]",
    ),
    "short circuit": (
        (1,),
        {"c1": (4.0, 0.2)},
        UnexpectedHeatError,
        "unexpected resistance of the spring of channel 1.*found 0.05",
    ),
}


@pytest.mark.parametrize("row", ROWS)
def test_what_measurements_mean(row):
    closed, channels, error, message = ROWS[row]
    heat = watch(closed)
    if error is None:
        heat.check(measured(**channels))
        return
    with pytest.raises(error, match=message):
        heat.check(measured(**channels))


def test_a_supply_that_goes_off_is_noticed():
    heat = watch((1,))
    heat.check(measured(10.0))
    heat.check(measured(11.0, c1=HOT))
    with pytest.raises(UnexpectedHeatError, match=r"no current flows in channel 1.*is the supply on"):
        heat.check(measured(12.0))


def test_saturated_is_too_much_and_where_open_it_flows():
    with pytest.raises(UnexpectedHeatError, match=r"too much current flows in channel 1.*8\.19 A or more"):
        watch().check(measured(saturated=(1,), c1=(8.19, 8.0)))
    with pytest.raises(CurrentFlowsError, match="channel 2"):
        watch().check(measured(saturated=(2,), c1=HOT, c2=(8.19, 8.0)))


def test_a_contact_is_judged_only_when_it_has_moved():
    """Neither the current that still flows nor the one that does not yet flow is a fault."""
    broken = (0.0, 11.0)
    heat = watch(since=5.0)
    heat.check(measured(5.15, c1=broken))
    with pytest.raises(UnexpectedHeatError, match="no current"):
        heat.check(measured(5.25, c1=broken))
    heat.record_switching({1: False}, 6.0)
    heat.check(measured(6.04, c1=HOT))
    with pytest.raises(CurrentFlowsError, match="channel 1"):
        heat.check(measured(6.06, c1=HOT))
    with pytest.raises(CurrentFlowsError, match="channel 3"):
        heat.check(measured(6.04, c3=HOT))


def test_repeating_a_command_does_not_postpone_the_judgement():
    """A board with timed pulses gets its commands four times a second."""
    heat = watch(since=5.0)
    for k in range(8):
        heat.record_switching({1: True}, 5.0 + 0.25 * k)
    with pytest.raises(UnexpectedHeatError, match="no current"):
        heat.check(measured(6.76, c1=(0.0, 11.0)))


def test_none_may_flow_at_the_start_and_at_the_end():
    heat = watch((1,))
    heat.require_none(measured())
    for channel in (1, 2, 3, 4):
        with pytest.raises(
            CurrentFlowsError, match=rf"channel {channel} .*found 4\.00 A; cut the heating supply"
        ):
            heat.require_none(measured(**{f"c{channel}": HOT}))


def test_channels_without_an_input_are_not_judged():
    rig = rig_with(sensor={"kind": "ina226", "channels": (1, 3)})
    heat = MeasuredHeat(rig, rig.sensor)
    heat.record_switching({2: True}, 0.0)
    heat.check(measured(c2=(9.0, 0.0), c4=HOT))
    with pytest.raises(CurrentFlowsError, match="channel 3"):
        heat.check(measured(c3=HOT))


def test_a_coarse_chip_gets_wider_bounds():
    """What an INA3221 on a small shunt may show by its own errors is no fault."""
    coarse = rig_with(sensor={"kind": "ina3221", "shunt_ohm": 0.002}, supply=FOUR)
    heat = watch(rig=coarse)
    heat.check(measured(c1=(4.3, 4.2), c2=(0.17, 0.0)))
    with pytest.raises(CurrentFlowsError):
        heat.check(measured(c1=HOT, c2=(0.19, 0.0)))
    with pytest.raises(UnexpectedHeatError, match="too much"):
        heat.check(measured(c1=(4.36, 4.2)))


def test_a_rig_without_measured_values_is_refused():
    rig = rig_with(sensor={"kind": "ina226"}, springs={"resistance_ohm": None})
    with raises(LimitError, "limit.not-measured", "springs.resistance_ohm"):
        MeasuredHeat(rig, rig.sensor)
