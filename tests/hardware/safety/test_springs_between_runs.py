"""Heat and rest of springs go on from one run to the next: the model."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.built.heat import HeatModel, SpringState
from eldir_hardware.guardian._interlock import Interlock
from eldir_hardware.guardian.pulse_controller import SuspendedError
from eldir_hardware.relay.errors import SilentBoardError
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import worst_springs
from eldir_hardware.safety.limits import LimitError
from eldir_hardware.safety.spring_memory import (
    MAX_AGE,
    SpringHeat,
    springs_at_limit,
)
from tests.hardware.guardian.pulse_controllers import FAN, controlled, rig_of
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.safety.remembered_springs import COLD, PLACES, WARM

OPEN, DT = (False,) * 4, 0.01


@settings(max_examples=30)
@given(
    pulse=st.floats(0.5, 6.0),
    age=st.floats(0.0, 120.0),
    channel=st.sampled_from([1, 2, 3, 4]),
)
def test_a_second_guardian_goes_on_from_the_first(pulse, age, channel):
    """Temperatures by the heat model, in still air; rests by the clock."""
    rig = rig_with()
    only = tuple(c == channel for c in range(1, 5))
    first = Interlock(rig, 0.0)
    first.record_switching({channel: True}, 0.0)
    first.record_report(only, 0.1)
    first.record_switching({channel: False}, pulse)
    first.record_report(OPEN, pulse + 0.1)
    left = {c: heat.aged_by(age) for c, heat in first.export_springs(pulse + 0.1).items()}
    second = Interlock(rig, 5000.0, left)
    still, steps = replace(rig.spring_parameters(), fan=False), max(round(age / DT), 1)
    state = SpringState(np.array(left[channel].temperature_c[:1]), np.array(left[channel].martensite[:1]))
    cooled = (
        HeatModel([still]).run(np.zeros((steps, 1)), age / steps if age else 1e-9, state).temperature[-1, 0]
    )
    assert second.temperatures[channel - 1] == pytest.approx(float(cooled), abs=0.3)
    assert np.delete(second.temperatures, channel - 1) == pytest.approx([22.0] * 3, abs=0.01)
    missing = rig.limits.min_off_s - (age + 0.1)
    assert second.rest_time(5000.0) >= missing - 1e-6
    for ahead in (missing - 0.2, missing + 0.2):
        if ahead > 0:
            assert ("too little time to cool" in refusal(second, 5000.0 + ahead, channel)) == (
                ahead < missing
            )


def refusal(watch: Interlock, at: float, channel: int) -> str:
    try:
        watch.check_pulses(at, {channel: 0.5})
    except LimitError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("contactor", [False, True])
def test_what_is_left_at_once_is_what_was_found(contactor):
    """Of every channel, of this rig file or not."""
    rig = rig_of("modbus", {"kind": "contactor", "channel": 5}) if contactor else rig_with()
    found = {
        7: SpringHeat((50.0, 60.0), (0.2, 0.1), ((30.0, 27.0),)),
        1: SpringHeat((61.5, 70.25), (0.25, 0.125), ((12.0, 7.0), (40.0, 35.0))),
        2: SpringHeat((22.0, 30.0), (1.0, 1.0), ()),
        3: SpringHeat((22.0, 30.0), (1.0, 1.0), ((59.0, 58.0),)),
        4: SpringHeat((31.0, 35.0), (0.75, 0.5), ((20.0, 19.0),)),
    }
    found = {channel: replace(heat, place=PLACES.get(channel)) for channel, heat in found.items()}
    watch = Interlock(rig, 500.0, found)
    left = watch.export_springs(500.0)
    assert left.keys() == found.keys()
    for channel, heat in left.items():
        assert heat.temperature_c == pytest.approx(found[channel].temperature_c)
        assert heat.martensite == pytest.approx(found[channel].martensite)
        assert np.allclose(sorted(heat.pulses_s), sorted(found[channel].pulses_s))
        assert heat.place == found[channel].place


def test_rest_and_heat_are_those_of_the_instant():
    """The last opening of any channel counts, and springs cool meanwhile."""
    hot = SpringHeat((60.0, 75.0), (0.0, 0.0), ((9.0, 4.0),))
    watch = Interlock(rig_with(), 50.0, {1: hot, 2: SpringHeat((22.0, 30.0), (1.0, 1.0), ((3.0, 1.0),))})
    watch.record_fan(True, 50.0)  # until then they cool in still air
    first, least = watch.rest_time(50.0), rig_with().limits.min_off_s
    assert watch.rest_time(53.0) == pytest.approx(first - 3.0, abs=1.1)
    assert watch.export_springs(60.0)[1].temperature_c[1] < 60.0
    cold = SpringHeat((22.0, 30.0), (1.0, 1.0), ())
    pulses = {1: replace(cold, pulses_s=((9.0, 4.0),)), 2: replace(cold, pulses_s=((3.0, 1.0),))}
    assert Interlock(rig_with(), 50.0, pulses).rest_time(50.0) == pytest.approx(least - 1.0)


@pytest.mark.parametrize("still", [None, 2.0])
def test_how_long_thick_springs_must_rest_is_known_at_once(still):
    """They cool for hours, and the program waits ten seconds for an answer. Against small steps."""
    thick = {"wire_diameter_mm": 3.0, "coil_diameter_mm": 12.0, "resistance_ohm": 0.1139}
    thick["convection_still"] = still
    rig = rig_with(fan=None, springs=thick, board={"channels": 8}, supply={"max_total_current_a": 100})
    entries = [{"channel": c, "spring": c - 1, "face": "front"} for c in range(1, 9)]
    rig = Rig.from_json(rig.model_dump() | {"channels": entries})
    for age in (0.0, 1800.0):
        hot = {c: heat.aged_by(age) for c, heat in springs_at_limit(rig).items()}
        begun = time.process_time()
        found = Interlock(rig, 5000.0, hot).rest_time(5000.0)
        assert time.process_time() - begun < 0.2
        worst, hottest = worst_springs(rig), np.array([rig.limits.max_temperature_c])
        history = HeatModel([worst]).run(np.zeros((40_000, 1)), 0.5, SpringState(hottest, np.zeros(1)))
        cooled = 0.5 * (np.flatnonzero(history.temperature[:, 0] <= worst.ambient + 2.0)[0] + 1)
        assert found == pytest.approx(cooled - age, abs=2.0) and cooled > 5000


def test_a_long_pause_of_an_idle_guardian_costs_no_time():
    """Such as of a ROS node that waits for a day."""
    rig = rig_with(fan=None, supply={"current_limit_a": 0.65})
    watch = Interlock(rig, 0.0, springs_at_limit(rig))
    begun = time.process_time()
    assert watch.export_springs(86_400.0)[1].temperature_c == pytest.approx((22.0, 30.0), abs=0.01)
    assert time.process_time() - begun < 0.2


def test_springs_that_may_be_hot_rest_until_even_the_hottest_has_cooled():
    """Against the heat model in small steps, from the ceiling."""
    rig = rig_with()
    watch = Interlock(rig, 100.0, springs_at_limit(rig))
    assert max(watch.temperatures) == pytest.approx(rig.limits.max_temperature_c, abs=0.5)
    worst, ceiling = worst_springs(rig), rig.limits.max_temperature_c
    state = SpringState(np.array([ceiling]), np.zeros(1))
    cooling = HeatModel([worst]).run(np.zeros((20_000, 1)), DT, state).temperature[:, 0]
    expected = DT * (np.flatnonzero(cooling <= worst.ambient + 2.0)[0] + 1)
    assert watch.rest_time(100.0) == pytest.approx(max(expected, rig.limits.min_off_s), abs=1.0)
    with pytest.raises(LimitError, match=r"too little time to cool|too hot"):
        watch.check_pulses(101.0, {1: 5.0})


def test_cold_springs_need_no_rest():
    for before in (None, {}, {1: WARM[1].aged_by(MAX_AGE)}):
        assert Interlock(rig_with(), 50.0, before).rest_time(50.0) == 0.0


def test_springs_of_another_rig_file_are_kept_for_its_next_run():
    """One board, two robots; the first time the springs of both may be the same ones."""
    other = replace(WARM[1], place=(5, "front"))
    watch = Interlock(rig_with(), 50.0, {7: other})
    assert watch.temperatures == (61.5,) * 4 and watch.rest_time(50.0) > 7.0
    left = watch.export_springs(400.0)
    assert left[7] == other.aged_by(350.0)
    again = Interlock(rig_with(), 500.0, {c: replace(heat, age_s=0.0) for c, heat in left.items()})
    assert again.temperatures == pytest.approx((22.0,) * 4, abs=0.1), "now it is known which ones are which"


def wired(*places: tuple[int, str], first: int = 1) -> Rig:
    """The template's rig with these springs on the channels from `first` on."""
    entries = [
        {"channel": channel, "spring": spring, "face": face}
        for channel, (spring, face) in enumerate(places, start=first)
    ]
    values = rig_with(board={"channels": 8}).model_dump()
    return Rig.from_json(values | {"channels": entries})


A, B, C, D = PLACES.values()


@pytest.mark.parametrize(
    ("rig", "warm"),
    [
        (wired(A, B, C, D), {A}),
        (wired(C, B, A, D), {A, C}),  # swapped wires, or a file that was wrong
        (wired((3, "front"), B, C, D), {(3, "front")}),  # another number
        (wired((3, "front"), (3, "back"), (2, "front")), {(3, "front"), (3, "back"), (2, "front")}),
        (wired(A, B, C, D, first=5), {A, B, C, D}),  # other channels
        (wired(B, C, D, A), {A, B, C, D}),
        (wired(C, D), {C, D}),
    ],
)  # fmt: skip
def test_heat_follows_springs_that_were_rewired_or_renamed(rig, warm):
    """Channel 1 heated spring A, with pulses; none of the springs that may be it counts as cold or rested."""
    before = Interlock(wired(A, B, C, D), 0.0)
    before.record_switching({1: True}, 0.0)
    before.record_switching({1: False}, 5.0)
    hot = before.temperatures[0]
    assert hot > 50
    left = {channel: heat.aged_by(2.0) for channel, heat in before.export_springs(5.0).items()}
    after = Interlock(rig, 1000.0, left)
    model = HeatModel([replace(rig.spring_parameters(), fan=False)])
    cooled = model.run(np.zeros((200, 1)), DT, SpringState(np.array([hot]), np.zeros(1))).temperature[-1, 0]
    for place, channel, found in zip(after._places.values(), after._places, after.temperatures, strict=True):
        assert found == pytest.approx(cooled if place in warm else 22.0, abs=0.3), place
        assert ("too little time to cool" in refusal(after, 1001.0, channel)) == (place in warm)
    assert after.rest_time(1000.0) > 6.0 - 1e-6


def test_heat_of_a_spring_follows_it_to_a_channel_that_heated_it_long_ago():
    """Two rig files, one robot."""
    cold = SpringHeat((22.0, 30.0), (1.0, 1.0), (), 500.0, PLACES[1])
    watch = Interlock(rig_with(), 50.0, {1: cold, 7: WARM[1]})
    assert watch.temperatures == pytest.approx((61.5, 61.5, 61.5, 61.5)), "2 to 4 are not known"
    every = {c: replace(COLD, place=place) for c, place in PLACES.items()}
    watch = Interlock(rig_with(), 50.0, every | {7: WARM[1]})
    assert watch.temperatures == pytest.approx((61.5, 22.0, 22.0, 22.0))


def test_pulses_of_springs_that_may_be_one_count_once():
    """Four springs that were heated together have used a quarter of their sum."""
    pulses = {c: SpringHeat((22.0, 30.0), (1.0, 1.0), ((30.0, 24.0), (14.0, 10.0))) for c in PLACES}
    pulses[4] = replace(pulses[4], pulses_s=((26.0, 22.0),))
    left = Interlock(rig_with(), 50.0, pulses).export_springs(50.0)
    assert all(np.allclose(heat.pulses_s, ((30.0, 22.0), (14.0, 10.0))) for heat in left.values())


def test_between_two_runs_no_fan_blows():
    """It was switched off with everything else: against the heat model in still air."""
    rig = rig_of(**FAN)
    worst = replace(worst_springs(rig), fan=False)
    assert worst_springs(rig).fan
    cooling = HeatModel([worst]).run(np.zeros((2000, 1)), DT, SpringState(np.array([76.0]), np.zeros(1)))
    watch = Interlock(rig, 50.0, {1: SpringHeat((60.0, 76.0), (0.0, 0.0), (), 20.0)})
    hottest = watch.export_springs(50.0)[1].temperature_c[1]
    assert hottest == pytest.approx(float(cooling.temperature[-1, 0]), abs=0.5) and hottest > 55


def test_what_a_run_found_hot_is_neither_its_peak_nor_its_fault():
    """Such as with a ceiling that was lowered since."""
    rig = rig_with()
    ceiling = rig.limits.max_temperature_c
    watch = Interlock(rig, 50.0, {1: SpringHeat((ceiling + 3.0, ceiling + 4.0), (0.0, 0.0), ())})
    watch.record_report(OPEN, 50.1)
    watch.check(50.1)
    watch.record_report(OPEN, 300.0)
    watch.record_switching({2: True}, 300.0)
    watch.record_report((False, True, False, False), 300.1)
    assert watch.peak < 40.0


def test_heat_that_no_report_has_shown_is_remembered():
    """A contact was closed, and everything was switched off before the next read-back."""
    watch = Interlock(rig_with(), 0.0)
    watch.record_switching({1: True}, 0.2)
    watch.record_switching({1: False}, 0.7)
    spring = rig_with().spring_parameters()
    expected = HeatModel([spring]).run(np.ones((50, 1)), DT).temperature[-1, 0]
    assert watch.export_springs(0.7)[1].temperature_c[0] == pytest.approx(expected, abs=0.3) and expected > 24


def test_a_run_waits_until_half_of_the_duty_is_free_again():
    rig = rig_with(limits={"duty": 0.3})
    pulses = ((34.0, 28.0), (20.0, 14.0), (6.0, 0.0))
    watch = Interlock(rig, 100.0, {1: SpringHeat((22.0, 30.0), (1.0, 1.0), pulses)})
    assert watch.rest_time(100.0) == pytest.approx(60.0 - 20.0 + 3.0, abs=1.1), "9 s of 18 are left then"
    later = Interlock(rig, 100.0, {1: SpringHeat((22.0, 30.0), (1.0, 1.0), pulses, 10.0)})
    assert later.rest_time(100.0) == pytest.approx(60.0 - 20.0 + 3.0 - 10.0, abs=1.1)


def test_the_same_controller_tells_its_rest_when_it_is_armed():
    with controlled(rig_with()) as (virtual, bank, _):
        bank.arm()
        assert bank.ready_at <= virtual.clock.now()
        bank.heat(1.0, {1: 5.0})
        bank.wait_until(6.5)
        bank.disarm()
        left = bank.export_springs()
        assert left[1].temperature_c[0] > 45 and left[2].temperature_c[0] == pytest.approx(22.0, abs=0.01)
        bank.arm()
        assert bank.ready_at > virtual.clock.now() + rig_with().limits.min_off_s - 1.5


@pytest.mark.parametrize("silent", [False, True])
def test_springs_may_be_hot_if_the_computer_slept_while_they_were_heated(silent):
    """Also where the run ends for what the sleep did to the board, such as a port that is lost."""
    slept = [7.0]
    with controlled(rig_with(), lambda: slept[0]) as (virtual, bank, _):
        slept[0] = 60.0  # before it arms: nothing was closed
        bank.arm()
        bank.heat(1.0, {1: 5.0})
        bank.wait_until(2.0)
        assert bank.export_springs() is not None
        slept[0] += 3600.0
        virtual.emulator.faults.silent = silent
        with pytest.raises(SilentBoardError if silent else SuspendedError):
            bank.wait_until(4.0) if not silent else bank._read_back()
        virtual.emulator.faults.silent = False
        bank.stop("it was asleep")
        assert bank.export_springs() is None


def test_a_spring_behind_a_contactor_begins_as_hot_as_the_hottest():
    """Its contact may be welded, and any pulse of another channel heats it."""
    hot = {1: SpringHeat((80.0, 86.0), (0.0, 0.0), (), place=PLACES[1])}
    hot |= {c: replace(COLD, place=place) for c, place in PLACES.items() if c > 1}
    welded = Interlock(rig_of("modbus", {"kind": "contactor", "channel": 5}), 50.0, hot)
    alone = Interlock(rig_of("modbus", {"kind": "timer", "max_on_s": 6.3}), 50.0, hot)
    assert "a spring would get too hot" in refusal_of(welded, {2: 3.0})
    assert refusal_of(alone, {2: 3.0}) == ""


def refusal_of(watch: Interlock, lengths: dict[int, float]) -> str:
    try:
        watch.check_pulses(50.5, lengths)
    except LimitError as error:
        return str(error)
    return ""


def test_springs_of_which_nobody_knows_have_just_been_heated_for_as_long_as_allowed():
    """They rest from now on, whether or not they are hot."""
    rig = rig_with(limits={"max_on_s": 4.0, "min_off_s": 50.0})
    watch = Interlock(rig, 100.0, springs_at_limit(rig))
    assert watch.rest_time(100.0) == pytest.approx(50.0, abs=1e-6)
    assert all(heat.pulses_s == ((4.0, 0.0),) for heat in watch.export_springs(100.0).values())
    assert "too little time to cool" in refusal(watch, 149.0, 1)
