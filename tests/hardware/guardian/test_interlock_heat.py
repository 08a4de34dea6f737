"""The interlock's temperatures, against the heat model over the times that contacts count as closed."""

import numpy as np
import pytest

from eldir.built.heat import HeatModel, SpringState
from eldir_hardware.guardian._interlock import Interlock
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import power_shares, worst_springs
from eldir_hardware.safety.limits import LimitError
from tests.hardware.guardian.pulse_controllers import rig_of
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

OPEN = (False,) * 4
DT = 0.01


def heated(rig: Rig, *spans: tuple[float, float, float], until: float) -> float:
    """Temperature of a nominal spring that is heated from begin to end by this part of its heat alone [C]."""
    times = np.arange(round(until / DT)) * DT
    on = np.zeros(len(times))
    for begin, end, part in spans:
        on[(times >= begin - 1e-9) & (times < end - 1e-9)] = part
    return float(HeatModel([rig.spring_parameters()]).run(on[:, None], DT).temperature[-1, 0])


def only(*channels: int) -> tuple[bool, ...]:
    return tuple(c in channels for c in range(1, 5))


def test_before_anything_heats():
    watch = Interlock(rig_with(), 5.0)
    assert watch.temperatures == (22.0,) * 4 and watch.peak == 22.0
    watch.record_report(OPEN, 25.0)
    assert watch.temperatures == pytest.approx((22.0,) * 4) and watch.peak == pytest.approx(22.0)


# Between two reports a contact counts as closed if either says so.


@pytest.mark.parametrize(
    ("reports", "span"),
    [
        ([(1.0, only(2)), (3.0, only(2)), (4.0, OPEN)], (0.0, 4.0)),
        ([(1.0, OPEN), (2.0, only(2)), (3.0, OPEN), (4.0, OPEN)], (1.0, 3.0)),
        ([(2.0, only(2)), (2.5, only(2)), (3.0, only(2)), (4.0, only(2))], (0.0, 4.0)),
    ],
)
def test_what_is_believed_between_reports(reports, span):
    rig = rig_with()
    watch = Interlock(rig, 10.0)
    for t, closed in reports:
        watch.record_report(closed, 10.0 + t)
    expected = heated(rig, (*span, 1.0), until=4.0)
    assert watch.temperatures == pytest.approx((22.0, expected, 22.0, 22.0), abs=0.05)
    assert watch.peak == pytest.approx(heated(rig, (*span, 1.0), until=span[1]), abs=0.3)


@pytest.mark.parametrize(
    ("says", "span"), [(OPEN, (0.0, 1.4)), (only(2), (0.0, 2.0))], ids=["follows", "stuck"]
)
def test_what_was_opened_counts_as_open_from_the_command_if_the_report_agrees(says, span):
    rig = rig_with()
    watch = Interlock(rig, 0.0)
    watch.record_report(only(2), 1.0)
    watch.record_switching({2: False}, 1.4)
    watch.record_report(says, 2.0)
    assert watch.temperatures[1] == pytest.approx(heated(rig, (*span, 1.0), until=2.0), abs=0.05)


def test_what_another_command_leaves_closed_heats_until_the_next_report():
    rig = rig_with()
    watch = Interlock(rig, 0.0)
    watch.record_report(only(1, 2), 1.0)
    watch.record_switching({1: False}, 1.2)
    watch.record_report(OPEN, 2.0)
    first, second = (heated(rig, (0.0, end, 1.0), until=2.0) for end in (1.2, 2.0))
    assert watch.temperatures[:2] == pytest.approx((first, second), abs=0.05) and second > first + 3.0


def test_commands_alone_heat_nothing():
    """Until the board says so: the model follows the report."""
    rig = rig_with()
    watch = Interlock(rig, 0.0)
    watch.record_switching({1: True}, 1.0)
    watch.record_report(OPEN, 2.0)
    assert watch.temperatures == pytest.approx((22.0,) * 4)
    watch.record_switching({2: True, 3: False}, 2.0)
    watch.record_report(only(2), 3.0)
    assert watch.temperatures[1] == pytest.approx(heated(rig, (0.0, 1.0, 1.0), until=1.0), abs=0.05)


def test_the_hottest_is_kept():
    rig = rig_with()
    watch = Interlock(rig, 0.0)
    watch.record_report(only(1), 3.0)
    watch.record_report(OPEN, 3.1)
    hottest = watch.peak
    assert hottest == pytest.approx(heated(rig, (0.0, 3.1, 1.0), until=3.1), abs=0.05)
    watch.record_report(OPEN, 40.0)
    assert watch.temperatures[0] < 30.0 and watch.peak == hottest
    watch.record_report(only(4), 41.0)
    watch.record_report(only(4), 40.0)  # a report that is late changes nothing
    assert watch.peak == hottest


def test_cooling_is_modelled_well_enough():
    """In larger steps; three of four springs cool while one is heated."""
    rig = rig_with()
    watch = Interlock(rig, 0.0)
    watch.record_report(only(1), 4.0)
    watch.record_report(OPEN, 4.0)
    for t in (10.3, 16.0):
        watch.record_report(OPEN, t)
    assert watch.temperatures[0] == pytest.approx(heated(rig, (0.0, 4.0, 1.0), until=16.0), abs=0.2)


# A supply that springs share.


def sharing(tolerance: float = 0.05) -> Rig:
    """With thermal switches, which allow any spring."""
    supply = {"outputs": "shared", "current_limit_a": 4.0, "max_total_current_a": 4.2}
    values = rig_with(supply=supply, springs={"resistance_tolerance": tolerance}).model_dump()
    return Rig.from_json(values | {"cutoff": {"kind": "thermal", "opens_at_c": 85.0}})


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_springs_that_heat_together_share(number):
    rig = sharing()
    watch = Interlock(rig, 0.0)
    channels = tuple(range(1, number + 1))
    watch.record_report(only(*channels), 0.5)
    watch.record_report(only(*channels), 2.0)
    part = float(power_shares(rig, rig.spring_parameters())[number])
    expected = heated(rig, (0.0, 2.0, part), until=2.0)
    assert watch.temperatures[:number] == pytest.approx((expected,) * number, abs=0.1)
    assert number == 1 or part < 0.5


def test_the_worst_spring_shares_only_with_what_is_surely_closed():
    """Three contacts open between two reports, nobody knows when: the fourth is believed to have had all."""
    rig = sharing(tolerance=0.3)
    worst = worst_springs(rig)
    parts = power_shares(rig, worst, worst=True)
    assert parts[4] > 1.1 * power_shares(rig, worst)[4], "one of little resistance draws more than its part"
    watch = Interlock(rig, 0.0)
    watch.record_report(only(1, 2, 3, 4), 0.0)
    watch.record_report(only(1, 2, 3, 4), 5.0)
    on = np.full(500, parts[4])
    expected = HeatModel([worst]).run(on[:, None], DT).temperature[-1, 0]
    assert float(watch._state.temperature[4]) == pytest.approx(expected, abs=0.1)
    watch.record_report(only(1), 5.5)
    on = np.concatenate([on, np.full(50, parts[1])])
    expected = HeatModel([worst]).run(on[:, None], DT).temperature[-1, 0]
    assert float(watch._state.temperature[4]) == pytest.approx(expected, abs=0.2)


def test_the_worst_spring_does_not_share_with_what_has_just_closed():
    """Three contacts close between two reports, nobody knows when: the fourth had all until the last one."""
    rig = sharing(tolerance=0.3)
    worst = worst_springs(rig)
    watch = Interlock(rig, 0.0)
    watch.record_report(only(1), 0.0)
    watch.record_report(only(1, 2, 3, 4), 0.5)
    on = np.full((50, 1), power_shares(rig, worst, worst=True)[1])
    expected = HeatModel([worst]).run(on, DT).temperature[-1, 0]
    assert float(watch._state.temperature[4]) == pytest.approx(expected, abs=0.2)


# The forecast of a pulse.


def warm(watch: Interlock, temperature: float) -> None:
    """All springs have this temperature, still below the change of phase or all above it."""
    count = len(watch._state.temperature)
    watch._state = SpringState(np.full(count, temperature), np.full(count, float(temperature < 45.0)))


def longest_safe(rig: Rig, temperature: float) -> float:
    """How long a worst spring may be heated from a temperature until it is at the ceiling [s]."""
    worst = worst_springs(rig)
    state = SpringState(np.array([temperature]), np.array([float(temperature < 45.0)]))
    rising = HeatModel([worst]).run(np.ones((1000, 1)), DT, state).temperature[:, 0]
    return DT * int(np.argmax(rising > rig.limits.max_temperature_c))


@pytest.mark.parametrize(("less", "allowed"), [(0.05, True), (-0.05, False)])
def test_a_pulse_and_a_step_of_the_timer_stay_below_the_ceiling(less, allowed):
    """With thermal switches as the cut-off, so that it is the pulse that counts."""
    values = rig_with().model_dump() | {"cutoff": {"kind": "thermal", "opens_at_c": 85.0}}
    rig = Rig.from_json(values)
    watch = Interlock(rig, 0.0)
    warm(watch, 60.0)
    seconds = longest_safe(rig, 60.0) - 0.1 - less
    assert 0.5 < seconds < 6.0
    if allowed:
        watch.check_pulses(0.0, {1: seconds})
        watch.check_pulses(0.0, {2: 0.1, 1: seconds})
    else:
        with raises(LimitError, "limit.too-hot", match="by the model.*at most 90 C"):
            watch.check_pulses(0.0, {2: 0.1, 1: seconds})


@pytest.mark.parametrize(("temperature", "allowed"), [(22.0, True), (50.0, False)])
def test_a_short_pulse_is_forecast_until_the_cutoff_acts(temperature, allowed):
    """The contact may weld: then the timer opens the circuit after 6.3 s, not the end of the pulse."""
    watch = Interlock(rig_with(), 0.0)
    warm(watch, temperature)
    if allowed:
        watch.check_pulses(1.0, {1: 0.1})
    else:
        with raises(LimitError, "limit.too-hot", match="by the model"):
            watch.check_pulses(1.0, {1: 0.1})


def test_only_the_springs_that_are_to_be_heated_are_forecast_hotter():
    """One that is hot already, but will be left alone, prevents no other."""
    watch = Interlock(rig_with(), 0.0)
    count = len(watch._state.temperature)
    hot = np.full(count, 22.0)
    hot[[2, 6]] = 70.0  # channel 3, nominal and worst
    watch._state = SpringState(hot, np.ones(count))
    watch.check_pulses(1.0, {1: 6.0, 4: 6.0})
    with raises(LimitError, "limit.too-hot", match="by the model"):
        watch.check_pulses(1.0, {3: 3.0})


@pytest.mark.parametrize(("spring", "channel"), [(0, 1), (3, 4), (4, 1), (6, 3)])
def test_which_spring_is_too_hot(spring, channel):
    """Nominal springs first, then those of the greatest resistance."""
    watch = Interlock(rig_with(), 0.0)
    count = len(watch._state.temperature)
    hot = np.full(count, 89.9)
    watch._state = SpringState(hot, np.zeros(count))
    watch.check(0.0)
    hot[spring] = 90.1
    watch._state = SpringState(hot, np.zeros(count))
    with raises(LimitError, "limit.too-hot", match=f"channel {channel} .*by the model"):
        watch.check(0.0)


# Behind a contactor.


def test_a_contact_welded_behind_a_contactor_heats_whenever_any_does():
    """Nobody sees it: its spring is modelled as if it were heated with each of the others."""
    rig = rig_of("modbus", {"kind": "contactor", "channel": 5})
    watch = Interlock(rig, 0.0)
    assert len(watch._state.temperature) == 9 == 1 + len(Interlock(rig_with(), 0.0)._state.temperature)
    worst = worst_springs(rig)
    for k, channel in enumerate((1, 2, 3)):
        closed = (*only(channel), True)
        watch.record_report(closed, 1.0 * k)
        watch.record_report(closed, 1.0 * (k + 1))
    expected = HeatModel([worst]).run(np.ones((300, 1)), DT).temperature[-1, 0]
    assert float(watch._state.temperature[8]) == pytest.approx(expected, abs=0.3)
    assert max(watch.temperatures) < expected - 10.0
    cold = Interlock(rig, 0.0)
    cold.record_report((*OPEN, True), 2.0)
    cold.record_report((*OPEN, True), 4.0)
    assert cold.temperatures == pytest.approx((22.0,) * 4), "the contactor alone heats nothing"
    assert cold._state.temperature[4:] == pytest.approx([30.0] * 5), "as warm as the hottest air"
