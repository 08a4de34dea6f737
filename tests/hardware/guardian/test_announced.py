"""Pulses that are announced ahead keep the same limits as pulses announced one by one."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.built.heat import HeatModel, SpringState
from eldir_hardware.guardian._forecast import HORIZON, MAX_PULSES, Forecast, HeatingInterval
from eldir_hardware.guardian._interlock import Interlock
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import worst_springs
from eldir_hardware.safety.limits import TIMER_STEP, LimitError
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston
from tests.processor_time import in_units
from tests.raised import raises

LEAD = 0.3
TICK = 0.1


def taken_together(rig: Rig, pulses: list[HeatingInterval]) -> int:
    """How many pulses are accepted if all are announced at the start."""
    interlock, accepted = Interlock(rig, 0.0), []
    for pulse in pulses:
        try:
            interlock.check_pulses(pulse.begin, {pulse.channel: pulse.end - pulse.begin}, accepted)
        except LimitError:
            break
        accepted.append(pulse)
    return len(accepted)


def taken_one_by_one(rig: Rig, pulses: list[HeatingInterval]) -> int:
    """How many are accepted if each is announced shortly before it begins; the board reports every 0.1 s."""
    interlock, accepted, now = Interlock(rig, 0.0), [], 0.0
    for pulse in pulses:
        while now < pulse.begin - LEAD:
            step_on(interlock, rig, accepted, now)
            now = round(now + TICK, 1)
        ahead = [p for p in accepted if p.end > now]
        try:
            interlock.check_pulses(pulse.begin, {pulse.channel: pulse.end - pulse.begin}, ahead)
        except LimitError:
            break
        accepted.append(pulse)
    return len(accepted)


def step_on(interlock: Interlock, rig: Rig, pulses: list[HeatingInterval], now: float) -> None:
    """A tick of time: contacts move where they are due, and the board reports them."""
    then = round(now + TICK, 1)
    edges = [(p.begin, p.channel, True) for p in pulses] + [(p.end, p.channel, False) for p in pulses]
    for t, channel, on in sorted(edges):
        if now <= t < then:
            interlock.record_switching({channel: on}, t)
    closed = {p.channel for p in pulses if p.begin < then <= p.end}
    interlock.record_report(tuple(c in closed for c in range(1, rig.board.channels + 1)), then)


def train(length: float, every: float, count: int = 6) -> list[HeatingInterval]:
    return [HeatingInterval(LEAD + every * i, 1, LEAD + every * i + length) for i in range(count)]


def test_pulses_that_add_up_are_refused_together_as_one_by_one():
    """6 s every 14 s: the temperature climbs; and with a duty of 0.2, at most 12 s in a minute."""
    hot = train(6.0, 14.0, 4)
    little = rig_with(supply={"current_limit_a": 3.0}, limits={"duty": 0.2})
    rig = rig_with(
        supply={"current_limit_a": 3.55}, cutoff={"max_on_s": 6.1}, limits={"max_temperature_c": 88.5}
    )
    assert 1 <= taken_together(rig, hot) <= taken_one_by_one(rig, hot) < 4
    assert taken_together(little, hot) == taken_one_by_one(little, hot) == 2
    wide = rig_with(supply={"current_limit_a": 3.0})
    assert taken_together(wide, hot) == taken_one_by_one(wide, hot) == 4, "what is harmless is played"


def test_the_controller_looks_at_all_that_it_has_accepted():
    rig = rig_with(limits={"duty": 0.2})
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with (
            raises(LimitError, "limit.duty", match="at most 0.2 of any 60 s"),
            bank.armed(),
        ):
            bank.heat(1.0, {1: 6.0})
            bank.wait_until(3.0)
            assert virtual.emulator.contacts[0]
            bank.heat(20.0, {1: 6.0})
            bank.heat(40.0, {1: 1.0})
        assert not any(virtual.emulator.contacts)


@pytest.mark.parametrize(
    ("heating", "at", "lengths", "code", "found"),
    [
        (
            [HeatingInterval(20.0, 1, 23.0)],
            10.0,
            {1: 5.0},
            "no-rest",
            "found 5.00 s",
        ),  # before another
        ([HeatingInterval(20.0, 1, 23.0)], 30.0, {1: 5.0}, "no-rest", "found 7.00 s"),
        ([HeatingInterval(20.0, 1, 23.0)], 21.0, {1: 5.0}, "no-rest", "found 0.00 s"),
        ([HeatingInterval(12.0, c, 14.0) for c in (2, 3, 4)], 11.0, {1: 3.0}, "supply", None),
        ([HeatingInterval(12.0, c, 14.0) for c in (2, 3)], 11.0, {1: 3.0}, None, None),
        (
            [HeatingInterval(12.0, 2, 14.0), HeatingInterval(14.0, 3, 16.0), HeatingInterval(14.0, 4, 16.0)],
            12.0,
            {1: 4.0},
            None,
            None,
        ),
        (
            [HeatingInterval(0.0, 1, 3.0)] * MAX_PULSES,
            20.0,
            {1: 1.0},
            "announced",
            f"at most {MAX_PULSES}; found {MAX_PULSES + 1}",
        ),
        ([], HORIZON, {1: 1.0}, "announced", "expected its end within 60 s; found in 61.0 s"),
        ([], float("nan"), {1: 1.0}, "announced", "within 60 s"),
        ([], 1.0, {1: -1.0}, "long-pulse", "found -1 s"),
        ([], 1.0, {1: float("nan")}, "long-pulse", None),
    ],
)
def test_what_is_announced_counts(heating, at, lengths, code, found):
    """Rest before and after, current at each instant, number and distance of pulses."""
    rig = rig_with(supply={"max_total_current_a": 11})
    interlock = Interlock(rig, 0.0)
    if code is None:
        return interlock.check_pulses(at, lengths, heating)
    with raises(LimitError, f"limit.{code}", match=found):
        interlock.check_pulses(at, lengths, heating)


PULSES = st.lists(
    st.tuples(st.integers(0, 400), st.sampled_from([1, 2]), st.integers(2, 60)), min_size=2, max_size=6
)


@settings(max_examples=40, deadline=None)
@given(
    PULSES, st.sampled_from([0.2, 0.5, 1.0]), st.sampled_from([3.2, 3.45, 3.6]), st.sampled_from([1.0, 8.0])
)
def test_together_is_refused_whatever_is_refused_one_by_one(found, duty, current, rest):
    pulses = [HeatingInterval(LEAD + t / 10, c, LEAD + (t + on) / 10) for t, c, on in sorted(found)]
    limits = {"duty": duty, "min_off_s": rest}
    changes = {"supply": {"current_limit_a": current}, "cutoff": {"max_on_s": 6.05}, "limits": limits}
    one_by_one = taken_one_by_one(rig_with(**changes), pulses)
    # A little less: the forecast takes long steps.
    together = taken_together(rig_with(**changes | {"limits": limits | {"max_temperature_c": 89.9}}), pulses)
    assert together <= one_by_one


def test_the_forecast_agrees_with_short_steps_and_is_quick():
    """32 pulses on eight channels in a minute."""
    channels = [{"channel": c + 1, "spring": c // 2, "face": ("front", "back")[c % 2]} for c in range(8)]
    rig = rig_with(board={"channels": 8}, channels=channels)
    pulses = [
        HeatingInterval(0.3 + c / 9 + 14.0 * k, c + 1, 1.4 + c / 9 + 14.0 * k + 0.03 * c * k)
        for k in range(MAX_PULSES // 8)
        for c in range(8)
    ]
    worst = worst_springs(rig)
    cold = SpringState.cold(8, worst)
    forecast = Forecast(rig)
    taken = []
    for _ in range(5):
        begin = time.process_time()
        peak = forecast.predict_peak(0.0, cold, pulses)
        taken.append(time.process_time() - begin)
    print(f"\nforecast of {MAX_PULSES} pulses: {1e3 * min(taken):.0f} to {1e3 * max(taken):.0f} ms")
    assert in_units(min(taken)) < 15  # it takes 4
    dt = 0.01
    t = dt * np.arange(round(65 / dt))
    on = np.zeros((len(t), 8))
    for p in pulses:
        on[(t >= p.begin - 1e-9) & (t < p.end + TIMER_STEP - 1e-9), p.channel - 1] = 1.0
    history = HeatModel([worst] * 8).run(on, dt)
    stuck = []
    for p in pulses:
        k = round(p.begin / dt) - 1
        start = SpringState(*(x[k, p.channel - 1 :][:1] for x in (history.temperature, history.martensite)))
        stuck.append(HeatModel([worst]).run(np.ones((630, 1)), dt, start).temperature.max())
    assert peak == pytest.approx(max(history.temperature.max(), *stuck), abs=0.15)
