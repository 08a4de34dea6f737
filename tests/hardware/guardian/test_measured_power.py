"""Temperatures that follow the measured current, beside limits that do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.heat import HeatModel, SpringState
from eldir.errors import EldirError
from eldir_hardware.clock import VirtualClock
from eldir_hardware.current_sensor import Measurement
from eldir_hardware.guardian._interlock import Interlock
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.measured_heat import CURRENT_SETTLING, CurrentWatch, MeasuredHeat
from eldir_hardware.guardian.measured_power import MeasuredPower, describe_correction
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston

RIG = rig_with(sensor={"kind": "ina226", "channels": [1, 2, 3]})
NOMINAL = 3.45  # [A]
CHANNEL_3 = (False, False, True, False)


def test_it_is_the_mean_of_a_pulse_and_then_of_the_last_seconds():
    power = MeasuredPower(RIG)
    assert power.factors.tolist() == [1.0] * 4
    shown = [0.96, 0.98, 1.0, 1.02, 0.99]
    for ratio in shown:
        power.update({3: ratio * NOMINAL})
    assert power.factors == pytest.approx([1.0, 1.0, np.mean(shown) ** 2, 1.0])
    for ratio in shown:
        power.update({3: ratio * NOMINAL})
    before = np.sqrt(power.factors[2])
    assert before == pytest.approx(np.mean(shown))
    power.update({3: 1.04 * NOMINAL})  # the eleventh counts for a tenth
    assert power.factors[2] == pytest.approx((before + 0.1 * (1.04 - before)) ** 2)


def test_it_stays_within_the_tolerance():
    power = MeasuredPower(RIG)
    power.update({1: 0.5 * NOMINAL, 2: 1.5 * NOMINAL, 3: 1.04 * NOMINAL})
    assert power.factors == pytest.approx([0.95**2, 1.05**2, 1.04**2, 1.0])
    narrow = MeasuredPower(rig_with(tolerances={"current": 0.02}))
    narrow.update({1: 0.5 * NOMINAL})
    assert narrow.factors[0] == pytest.approx(0.98**2)


def test_on_a_shared_supply_springs_count_as_nominal():
    power = MeasuredPower(rig_with(supply={"outputs": "shared"}))
    power.update({1: 0.97 * NOMINAL})
    assert power.factors.tolist() == [1.0] * 4


def test_the_log_says_which_temperatures_follow():
    assert describe_correction(rig_with()) == ""
    assert describe_correction(rig_with(sensor={"kind": "ina226"}, supply={"outputs": "shared"})) == ""
    assert describe_correction(rig_with(sensor={"kind": "ina226", "channels": [3, 1, 2]})) == (
        "the temperatures follow the measured currents of channels 1, 2, 3, within 5 % of the rig file's; "
        "limits do not"
    )


def test_only_settled_currents_of_channels_that_heat_count():
    heat = MeasuredHeat(RIG, RIG.sensor)

    def measured(at: float, currents: dict[int, float]) -> dict[int, float]:
        every = dict.fromkeys((1, 2, 3), 0.0) | currents
        return heat.heating_currents(Measurement(at, every, every, frozenset()))

    assert measured(0.0, {1: 3.4}) == {}, "it was not ordered to heat"
    heat.record_switching({1: True, 2: True, 4: True}, 1.0)
    assert measured(1.0 + CURRENT_SETTLING - 1e-6, {1: 3.4, 2: 3.3}) == {}
    assert measured(1.0 + CURRENT_SETTLING, {1: 3.4, 2: 3.3, 3: 3.2}) == {1: 3.4, 2: 3.3}
    assert measured(2.0, {1: 3.4, 2: 0.009}) == {1: 3.4}, "the supply of the other one is off"
    heat.record_switching({1: False}, 3.0)
    assert measured(4.0, {1: 3.4, 2: 3.3}) == {2: 3.3}


def test_without_a_measurement_nothing_counts():
    bare, shown = CurrentWatch(rig_with(), None, VirtualClock()), dict.fromkeys((1, 2, 3), 3.4)
    assert bare.heating_currents(None) == {}
    assert bare.heating_currents(Measurement(1.0, shown, shown, frozenset())) == {}
    watch = CurrentWatch(RIG, object(), VirtualClock())
    watch.record_switching({2: True})
    assert watch.heating_currents(None) == {}
    assert watch.heating_currents(Measurement(1.0, shown, shown, frozenset())) == {2: 3.4}


def played(ratio: float | None) -> Interlock:
    """Channel 3 closed for four seconds, of which a sensor shows this part of the nominal current."""
    watch = Interlock(RIG, 0.0)
    watch.record_switching({3: True}, 0.0)
    for t in np.arange(0.1, 4.01, 0.1):
        watch.record_report(CHANNEL_3, float(t))
        if ratio is not None:
            watch.record_currents({3: ratio * NOMINAL})
    watch.record_switching({3: False}, 4.0)
    watch.record_report((False,) * 4, 4.1)
    return watch


def test_the_nominal_spring_gets_the_measured_heat():
    """From the first measurement on, against the heat model by itself."""
    on = np.full((41, 1), 0.97**2)
    on[0] = 1.0
    model = HeatModel([RIG.spring_parameters()])
    expected = model.run(np.r_[on[:40], [[0.0]]], 0.1).temperature
    watch = played(0.97)
    assert watch.temperatures == pytest.approx([22.0, 22.0, expected[-1, 0], 22.0], abs=0.05)
    assert watch.peak == pytest.approx(expected.max(), abs=0.05) and watch.peak < played(None).peak - 0.7
    assert played(1.03).temperatures[2] > played(None).temperatures[2] + 0.7


@pytest.mark.parametrize("ratio", [0.2, 0.95, 1.05])
def test_limits_are_the_same_whatever_a_sensor_shows(ratio):
    """To the last bit: a sensor that shows too little current would else allow too hot pulses."""
    blind, seeing = played(None), played(ratio)
    worst = slice(4, None)
    assert (seeing._state.temperature[worst] == blind._state.temperature[worst]).all()
    assert (seeing._state.martensite[worst] == blind._state.martensite[worst]).all()
    assert seeing.rest_time(4.5) == pytest.approx(blind.rest_time(4.5), abs=1e-3), "another grid of times"
    kept = [watch.export_springs(5.0)[3] for watch in (blind, seeing)]
    assert kept[0].temperature_c[1] == kept[1].temperature_c[1] and kept[0].pulses_s == kept[1].pulses_s
    # The longest pulse of another spring's channel, and of its own, that is allowed.
    found = [[], []]
    for watch, answers in zip((blind, seeing), found, strict=True):
        for at, channel in ((5.5, 1), (12.5, 3), (20.0, 3)):
            for seconds in np.arange(2.0, 6.3, 0.2):
                try:
                    watch.check_pulses(at, {channel: float(seconds)})
                except LimitError as error:
                    answers.append((at, channel, error.code, str(error)))
    assert found[0] == found[1] and len({code for _, _, code, _ in found[0]}) >= 2


def test_a_sensor_that_shows_too_little_does_not_hide_that_a_spring_is_too_hot():
    errors = []
    for ratio in (None, 0.2):
        watch = Interlock(RIG, 0.0)
        watch.record_switching({3: True}, 0.0)
        for t in np.arange(0.1, 20.0, 0.1):
            watch.record_report(CHANNEL_3, float(t))
            if ratio is not None:
                watch.record_currents({3: ratio * NOMINAL})
            try:
                watch.check(float(t))
            except LimitError as error:
                errors.append((t, str(error)))
                break
    assert len(errors) == 2 and errors[0] == errors[1]


def errors_of_the_model(rig: Rig, current: float) -> np.ndarray:
    """Modelled minus true temperatures while all springs are heated once for 5.5 s [K], on a rig whose
    springs are nominal but for this part of the current."""
    found = []
    with VirtualRig(rig, Piston()) as virtual:
        nominal = rig.spring_parameters()
        virtual.springs.parameters = [
            replace(nominal, current_limit=current * nominal.current_limit) for _ in rig.channels
        ]
        virtual.springs.state = SpringState.cold(len(rig.channels), nominal)
        bank = PulseController(virtual.board, rig, virtual.clock, sensor=virtual.sensor)

        def compare(report: Report) -> None:
            virtual.springs.advance(report.t)
            found.append(np.array(report.temperatures) - virtual.springs.state.temperature)

        with bank.armed():
            begin = virtual.clock.now() + 0.5
            bank.heat(begin, dict.fromkeys((1, 2, 3, 4), 5.5))
            bank.wait_until(begin + 12.0, compare)
    return np.array(found)


@pytest.mark.parametrize("current", [0.95, 1.05])
def test_temperatures_on_a_virtual_rig_are_the_true_ones(current):
    """Through board, sensor and controller; the channel without an input stays nominal."""
    found = errors_of_the_model(RIG, current)
    rms, largest = np.sqrt((found**2).mean(axis=0)), np.abs(found).max(axis=0)
    assert (largest[:3] < 1.6).all() and (rms[:3] < 0.75).all(), "a shunt is right to 1 %"
    assert largest[3] > 2.5 and rms[3] > 1.2


def test_a_controller_without_a_sensor_needs_none():
    with pytest.raises(EldirError, match="not that of the rig file"), VirtualRig(RIG, Piston()) as virtual:
        PulseController(virtual.board, RIG, virtual.clock)
    assert np.abs(errors_of_the_model(rig_with(), 1.0)).max() < 1.6
