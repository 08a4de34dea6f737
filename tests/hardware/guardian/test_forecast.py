"""The forecast's own steps, against the heat model in steps of 5 ms."""

import numpy as np
import pytest

from eldir.built.heat import HeatModel, SpringState
from eldir_hardware.guardian._forecast import Forecast, HeatingInterval, closed_together
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import power_shares, worst_springs
from tests.hardware.guardian.pulse_controllers import rig_of
from tests.hardware.rigs_and_schedules import rig_with

DT = 0.005
STEP = 0.1  # every pulse may last so much longer [s]


def with_cutoff(cutoff: dict) -> Rig:
    return Rig.from_json(rig_with().model_dump() | {"cutoff": cutoff})


def peak(rig: Rig, until: float, *spans: tuple[float, float]) -> float:
    """Highest temperature of a worst spring, from cold [C]."""
    times = np.arange(round(until / DT)) * DT
    on = sum((times >= a - 1e-9) & (times < b - 1e-9) for a, b in spans)
    return float(HeatModel([worst_springs(rig)]).run(on[:, None] * 1.0, DT).temperature.max())


def cold(rig: Rig) -> SpringState:
    return SpringState.cold(len(rig.channels), worst_springs(rig))


@pytest.mark.parametrize("rest", [3.0, 11.0, 30.0])
def test_its_steps_are_short_enough(rest):
    """Without a contact that may weld: thermal switches."""
    rig = with_cutoff({"kind": "thermal", "opens_at_c": 85.0})
    second = 2.0 + rest
    pulses = [HeatingInterval(0.0, 1, 2.0), HeatingInterval(second, 1, second + 3.3)]
    found = Forecast(rig).predict_peak(0.0, cold(rig), pulses)
    expected = peak(rig, second + 4.0, (0.0, 2.0 + STEP), (second, second + 3.3 + STEP))
    print(f"rest {rest:g} s: {found - expected:+.3f} K")
    assert found == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("begin", [0.0, 1.0], ids=["at once", "ahead"])
@pytest.mark.parametrize("on", [0.33, 2.47, 6.3])
def test_a_contact_that_stays_closed_is_forecast_to_the_end_of_its_timer(on, begin):
    rig = with_cutoff({"kind": "timer", "max_on_s": on})
    found = Forecast(rig).predict_peak(0.0, cold(rig), [HeatingInterval(begin, 1, begin + 0.1)])
    expected = peak(rig, on + 1.0, (0.0, on))
    print(f"{on:g} s: {found - expected:+.3f} K")
    assert found == pytest.approx(expected, abs=0.1)


def test_springs_on_one_output_are_forecast_with_the_share_of_the_worst_one():
    """One that draws more than the others within the tolerance gets more than its part."""
    supply = {"outputs": "shared", "current_limit_a": 4.0, "max_total_current_a": 4.2}
    values = rig_with(supply=supply, springs={"resistance_tolerance": 0.3}).model_dump()
    rig = Rig.from_json(values | {"cutoff": {"kind": "thermal", "opens_at_c": 85.0}})
    worst = worst_springs(rig)
    on = np.zeros((1300, 4))
    on[:1200] = power_shares(rig, worst, worst=True)[4]
    on[1200:1220] = power_shares(rig, worst, worst=True)[1]  # the step longer: surely closed is none
    expected = HeatModel([worst] * 4).run(on, DT).temperature.max()
    found = Forecast(rig).predict_peak(0.0, cold(rig), [HeatingInterval(0.0, c, 6.0) for c in (1, 2, 3, 4)])
    print(f"{found - expected:+.3f} K")
    assert found == pytest.approx(expected, abs=0.15)


def test_what_is_hot_already_counts_though_it_only_cools():
    rig = with_cutoff({"kind": "thermal", "opens_at_c": 85.0})
    state = SpringState(np.array([30.0, 30.0, 95.0, 30.0]), np.zeros(4))
    assert Forecast(rig).predict_peak(7.0, state, [HeatingInterval(8.0, 1, 8.5)]) == 95.0


def test_the_timer_of_a_closed_contact_has_run_since_it_closed():
    rig = with_cutoff({"kind": "timer", "max_on_s": 6.3})
    found = Forecast(rig).predict_peak(10.0, cold(rig), [HeatingInterval(8.0, 2, 10.1)])
    assert found == pytest.approx(peak(rig, 5.0, (0.0, 4.3)), abs=0.1)


@pytest.mark.parametrize("now", [6.3, 8.0])
def test_a_timer_that_has_run_out_already_heats_no_more(now):
    """By its own pulse, which the model goes on with, it still does."""
    rig = with_cutoff({"kind": "timer", "max_on_s": 6.3})
    found = Forecast(rig).predict_peak(now, cold(rig), [HeatingInterval(0.0, 1, now + 0.5)])
    assert found == pytest.approx(peak(rig, 1.0, (0.0, 0.5 + STEP)), abs=0.1)


def test_a_contact_welded_behind_a_contactor_is_forecast_to_heat_with_each_of_the_others():
    rig = rig_of("modbus", {"kind": "contactor", "channel": 5})
    state = SpringState.cold(5, worst_springs(rig))
    pulses = [HeatingInterval(5.0 + k, channel, 6.0 + k) for k, channel in enumerate((1, 2, 3))]
    found = Forecast(rig).predict_peak(5.0, state, pulses)
    assert found == pytest.approx(peak(rig, 4.0, (0.0, 3.0 + STEP)), abs=0.15)


def test_of_several_contacts_the_one_with_the_most_time_left_counts():
    rig = with_cutoff({"kind": "timer", "max_on_s": 6.3})
    pulses = [HeatingInterval(4.0, 1, 10.1), HeatingInterval(10.0, 2, 10.1)]
    assert Forecast(rig).predict_peak(10.0, cold(rig), pulses) == pytest.approx(
        peak(rig, 7.0, (0.0, 6.3)), abs=0.1
    )


def test_what_is_together_within_the_slack():
    pulses = [
        HeatingInterval(0.0, 1, 2.0),
        HeatingInterval(0.5, 2, 2.0),
        HeatingInterval(1.0, 3, 2.0),
        HeatingInterval(0.0, 4, 0.5),
    ]
    assert closed_together(pulses, 0.5) == {0.0: {1, 2}, 0.5: {1, 2, 3}, 1.0: {1, 2, 3}}
