"""When the guardian asks its current sensor, and where exactly its bounds lie."""

import math
from contextlib import contextmanager

import pytest

from eldir.errors import EldirError
from eldir_hardware.clock import VirtualClock
from eldir_hardware.current_sensor import CHIPS, Measurement
from eldir_hardware.guardian import measured_heat
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.measured_heat import (
    CONTACT_DELAY,
    CURRENT_SETTLING,
    CurrentFlowsError,
    CurrentWatch,
    HeatBounds,
    MeasuredHeat,
    UnexpectedHeatError,
    describe_proof,
    require_no_current,
    supplied_channels,
)
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

RIG = rig_with(sensor={"kind": "ina226"}, supply={"current_limit_a": 4.0})
BARE = rig_with()
REPORT = Report(1.0, (True, False), (40.0,), 41.0, 0.01)


def measured(
    started_at: float = 0.0, saturated: tuple[int, ...] = (), **channels: tuple[float, float]
) -> Measurement:
    values = {c: channels.get(f"c{c}", (0.0, 0.0)) for c in (4, 3, 2, 1)}
    currents, volts = ({c: v[i] for c, v in values.items()} for i in (0, 1))
    return Measurement(started_at, currents, volts, frozenset(saturated))


class Sensor:
    """Measures what it is told, and takes its time."""

    query_time = 0.04

    def __init__(self, clock: VirtualClock, shown: Measurement):
        self.clock, self.shown = clock, shown
        self.asked: list[float] = []

    def measure(self) -> Measurement:
        self.asked.append(self.clock.now())
        return self.shown


def watch(shown: Measurement | None = None) -> tuple[CurrentWatch, Sensor, VirtualClock]:
    clock = VirtualClock()
    clock.sleep_until(5.0)
    sensor = Sensor(clock, shown or measured())
    return CurrentWatch(RIG, sensor, clock), sensor, clock


def test_the_sensor_must_be_the_rig_files():
    for rig, sensor in ((BARE, object()), (RIG, None)):
        with raises(EldirError, "sensor.other-opened"):
            CurrentWatch(rig, sensor, VirtualClock())


def test_without_a_sensor_nothing_is_measured_or_judged():
    bare = CurrentWatch(BARE, None, VirtualClock())
    bare.record_switching({1: True})
    assert bare.measure(1e9) is None and bare.add_to(REPORT, None) is REPORT
    bare.check(None)
    bare.check(measured(c1=(9.0, 9.0)))
    assert bare.prove_no_current() is None and bare.query_time == 0.0


def test_a_measurement_is_left_out_for_a_switching_but_not_for_long():
    """Each takes 0.04 s."""
    current, sensor, clock = watch()
    assert current.query_time == 0.04
    assert current.measure(5.04) is sensor.shown and current.measure(5.03) is None
    clock.sleep_until(5.59)
    assert current.measure(5.60) is None
    clock.sleep_until(5.601)
    assert current.measure(5.602) is sensor.shown, "that is too long"
    assert current.measure(5.62) is None, "counted from then on"
    assert sensor.asked == [5.0, pytest.approx(5.601)]


def test_what_was_measured_stands_in_the_rig_files_order():
    current, _, _ = watch()
    shown = measured(c1=(1.0, 11.0), c2=(2.0, 12.0))
    del shown.currents[3], shown.voltages[3]
    found = current.add_to(REPORT, shown)
    assert found[:5] == REPORT[:5]
    assert found.currents[:2] == (1.0, 2.0) and found.voltages[:2] == (11.0, 12.0)
    assert math.isnan(found.currents[2]) and math.isnan(found.voltages[2]) and found.currents[3] == 0.0


def test_measurements_are_judged_by_what_was_switched():
    current, _, clock = watch()
    current.check(None)
    with pytest.raises(CurrentFlowsError, match="channel 1"):
        current.check(measured(started_at=5.1, c1=(4.0, 3.95)))
    current.record_switching({1: True})
    current.check(measured(started_at=5.0 + CURRENT_SETTLING, c1=(4.0, 3.95)))
    clock.sleep_until(6.0)
    current.record_switching({1: False})
    with pytest.raises(CurrentFlowsError, match="channel 1"):
        current.check(measured(started_at=6.0 + CONTACT_DELAY, c1=(4.0, 3.95)))


def test_that_no_current_flows_is_measured_when_the_contacts_have_moved():
    current, sensor, _ = watch()
    assert current.prove_no_current() is not None and sensor.asked == [5.0 + CONTACT_DELAY]
    sensor.shown = measured(c3=(0.5, 0.5))
    with pytest.raises(CurrentFlowsError, match="channel 3"):
        current.prove_no_current()


@pytest.mark.parametrize("given", [False, True])
def test_that_no_current_flows_is_told_with_channels_and_milliamperes(monkeypatch, given):
    clock = VirtualClock()
    sensor = Sensor(clock, measured(c2=(-0.007, 0.0), c3=(0.004, 0.0)))
    asked = []

    @contextmanager
    def open_sensor(rig, used, port):
        asked.append((used, port))
        yield sensor if rig.sensor else None

    monkeypatch.setattr(measured_heat, "open_sensor", open_sensor)
    if given:
        text = require_no_current(RIG, "/dev/other", clock)
        assert text == (
            "the sensor shows no current in channels 1 to 4 (at most 7 mA), but outside a run it is "
            "unknown whether the supply is on, so this alone proves nothing"
        )
        text = require_no_current(RIG, "/dev/other", clock, {2, 3})
        assert text.startswith("no current flows in channels 2, 3 by the sensor")
        assert asked == [(clock, "/dev/other")] * 2 and sensor.asked == [CONTACT_DELAY, 2 * CONTACT_DELAY]
        sensor.shown = measured(c2=(-0.5, 0.0))
        with pytest.raises(CurrentFlowsError, match="channel 2"):
            require_no_current(RIG, "/dev/other", clock)
    else:
        assert require_no_current(BARE) is None and asked == []


SEEN = "no current flows in {} by the sensor (it measured the supply in {} in this run)"
BLIND = (
    "the sensor shows no current in {}, but it has not measured the supply{} in this run, "
    "so this proves nothing"
)


@pytest.mark.parametrize(
    ("inputs", "supplied", "expected"),
    [
        (None, {1, 2, 3, 4}, SEEN.format("channels 1 to 4", "all of them")),
        (None, {1, 3}, SEEN.format("channels 1, 3", "all of them")
         + "; " + BLIND.format("channels 2, 4", " there")),
        (None, set(), BLIND.format("channels 1 to 4", "")),
        ([2], {2}, f"{SEEN.format('channel 2', 'it')}; nothing measures channels 1, 3, 4"),
        ([1], set(), f"{BLIND.format('channel 1', '')}; nothing measures channels 2 to 4"),
        ([4, 1, 2], {1}, f"{SEEN.format('channel 1', 'it')}; {BLIND.format('channels 2, 4', ' there')}"
         "; nothing measures channel 3"),
    ],
)  # fmt: skip
def test_a_proof_names_the_channels_of_which_it_is_one(inputs, supplied, expected):
    rig = rig_with(sensor={"kind": "ina226", "channels": inputs})
    assert describe_proof(rig, supplied) == expected


def test_the_supply_is_seen_by_a_current_through_a_closed_contact_since_arming():
    current, _, clock = watch()
    current.record_switching({1: True})
    clock.sleep_until(6.0)
    current.check(measured(started_at=5.9, c1=(4.0, 3.95)))
    assert current.prove_no_current() == describe_proof(RIG, {1}), "of channel 2 nothing is known"
    current.record_switching({1: False})
    current.arm()
    assert current.prove_no_current() == describe_proof(RIG, ()), "another run"
    assert supplied_channels(RIG, (True, True, False, True), {1: 0.011, 2: 0.009, 3: 4.0, 4: math.nan}) == {1}
    assert supplied_channels(BARE, (True,), {1: 4.0}) == set()


# Bounds, from the chip's data sheet and the rig file.


def test_the_bounds_of_a_channel():
    """Computed again by hand: INA226, shunt of 10 mOhm and 1 %, 4 A and 5 %, 0.987 Ohm, 11 V."""
    entry = RIG.sensor
    chip, tolerance = CHIPS["ina226"], entry.shunt_tolerance
    for flowing in (-4.0, 0.001, 4.0):
        found = HeatBounds(RIG, entry).bounds(flowing)
        assert found.zero_current == pytest.approx(0.01)
        at_most = 1.05 * 4.0
        fixed = (10e-6 + 2 * 2.5e-6) / entry.shunt_ohm
        assert found.max_current == pytest.approx(at_most + fixed + (1e-3 + tolerance) * at_most)
        assert found.supply_voltage_threshold == pytest.approx(2.75)
        assert found.max_voltage == pytest.approx(12.1 + 7.5e-3 + 2 * 1.25e-3 + 1e-3 * 11.0)
        amperes = max(abs(flowing), 0.01)
        volts = amperes * 0.987
        relative = fixed / amperes + 1e-3 + tolerance + (7.5e-3 + 2 * 1.25e-3 + 1e-3 * volts) / volts
        deviation = entry.resistance_tolerance + relative
        assert found.resistances == pytest.approx(
            (0.987 * max(1 - deviation, 0), 0.987 * (1 + deviation)), rel=1e-6
        )
        assert chip.inputs == 1


def judged(shown: Measurement, closed: tuple[int, ...] = (1,), saw_supply: bool = True) -> None:
    heat = MeasuredHeat(RIG, RIG.sensor)
    heat.record_switching(dict.fromkeys(closed, True), -10.0)
    if saw_supply and closed:
        heat.check(measured(-5.0, **{f"c{c}": (4.0, 3.95) for c in closed}))
    heat.check(shown)


BOUNDS = HeatBounds(RIG, RIG.sensor).bounds(4.0)
MORE = 1e-9


@pytest.mark.parametrize(
    ("amperes", "volts", "wrong"),
    [
        (BOUNDS.max_current, BOUNDS.max_current * 0.987, ""),
        (BOUNDS.max_current + MORE, 4.0, "too much current"),
        (4.0, BOUNDS.max_voltage, "unexpected resistance"),
        (4.0, BOUNDS.max_voltage + MORE, "implausible voltage of channel 1"),
        (4.0, -BOUNDS.supply_voltage_threshold, "unexpected resistance"),
        (4.0, -BOUNDS.supply_voltage_threshold - MORE, "implausible voltage of channel 1"),
        (-BOUNDS.zero_current, 0.0, "no current flows"),
        (-BOUNDS.zero_current - MORE, 0.0, "flows backwards"),
        (BOUNDS.zero_current - MORE, BOUNDS.supply_voltage_threshold, "is the supply on"),
        (BOUNDS.zero_current - MORE, BOUNDS.supply_voltage_threshold + MORE, "is broken"),
        (BOUNDS.zero_current, 1.0, "unexpected resistance"),
        (4.0, 4.0 * BOUNDS.resistances[0], ""),
        (4.0, 4.0 * BOUNDS.resistances[1], ""),
        (4.0, 4.0 * BOUNDS.resistances[0] - 1e-6, "unexpected resistance"),
        (4.0, 4.0 * BOUNDS.resistances[1] + 1e-6, "unexpected resistance"),
    ],
)
def test_the_last_value_that_is_accepted_where_a_contact_is_closed(amperes, volts, wrong):
    shown = measured(c1=(amperes, volts))
    if not wrong:
        judged(shown)
        return
    with pytest.raises(UnexpectedHeatError, match=wrong):
        judged(shown)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_last_value_that_is_accepted_where_a_contact_is_open(sign):
    judged(measured(c2=(sign * BOUNDS.zero_current, sign * BOUNDS.supply_voltage_threshold)), ())
    for shown in (
        (sign * (BOUNDS.zero_current + MORE), 0.0),
        (0.0, sign * (BOUNDS.supply_voltage_threshold + MORE)),
    ):
        with pytest.raises(CurrentFlowsError, match="channel 2"):
            judged(measured(c2=shown), ())


@pytest.mark.parametrize(
    ("amperes", "volts", "seen"),
    [
        (BOUNDS.zero_current, BOUNDS.supply_voltage_threshold, False),
        (-BOUNDS.zero_current, -BOUNDS.supply_voltage_threshold, False),
        (-BOUNDS.zero_current - MORE, 0.0, True),
        (BOUNDS.zero_current + MORE, 1.0, True),
        (0.0, BOUNDS.supply_voltage_threshold + MORE, True),
        (0.0, -BOUNDS.supply_voltage_threshold - MORE, True),
    ],
)
def test_what_shows_that_the_supply_is_on(amperes, volts, seen):
    """Before it was seen, nothing is expected of a closed contact."""
    shown = measured(c1=(amperes, volts))
    if seen:
        with pytest.raises(UnexpectedHeatError):
            judged(shown, saw_supply=False)
    else:
        judged(shown, saw_supply=False)


def test_a_contact_is_judged_at_the_instant_when_it_has_moved():
    heat = MeasuredHeat(RIG, RIG.sensor)
    heat.check(measured(-1e6))
    heat.record_switching({1: True, 99: True}, 0.0)
    assert heat._closed == {1}
    heat.check(measured(CURRENT_SETTLING - MORE, c1=(9.0, 0.0)))
    with pytest.raises(UnexpectedHeatError):
        heat.check(measured(CURRENT_SETTLING, c1=(9.0, 0.0)))


def test_saturation_alone_is_too_much():
    with pytest.raises(UnexpectedHeatError, match="too much current"):
        judged(measured(saturated=(1,), c1=(4.0, 3.95)))
