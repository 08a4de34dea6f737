"""What a schedule must not be, to the last value that is allowed, on springs that hardly get warm."""

import numpy as np
import pytest

from eldir.built.heat import HeatModel, SpringState, heat
from eldir_hardware.planning.compiler import describe_precision
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import power_shares, worst_springs
from eldir_hardware.safety import limits
from eldir_hardware.safety.limits import LimitError
from eldir_hardware.safety.worst_heat import stuck_temperature
from eldir_hardware.schedule import ActuationSchedule, Event
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

DT = 0.02
"""Of the finer grid [s]."""
PERIODS = 20
"""Then temperatures repeat."""
PLACES = {1: (0, "front"), 2: (0, "back"), 3: (1, "front"), 4: (1, "back")}


def weak(**entries: object) -> Rig:
    """So little current that times alone decide; 1 A is at most 1.05 A."""
    return rig_with(**{"supply": {"current_limit_a": 1.0, "max_total_current_a": 2.1}} | entries)


def schedule(period: float, *pulses: tuple[int, float, float]) -> ActuationSchedule:
    """Of channel, start and length of each pulse."""
    events = []
    for channel, start, length in pulses:
        place = PLACES[channel]
        events.append(Event(start, *place, channel, True))
        events.append(Event((start + length) % period, *place, channel, False))
    return ActuationSchedule(period, events=tuple(sorted(events)), cycles=1)


def refused(code: str, made: ActuationSchedule, rig: Rig, said: str = "") -> None:
    with raises(LimitError, f"limit.{code}", match=said):
        limits.check_schedule(made, rig)


def test_a_schedule_that_heats_nothing():
    refused("no-pulse", schedule(20.0), weak())
    assert describe_precision(schedule(20.0), weak()) == "", "eldir rig drive asks for this first"


@pytest.mark.parametrize(
    ("longest", "cutoff", "length", "most"),
    [
        (6.0, 6.3, 6.0, None),
        (6.0, 6.3, 6.0 + 1e-6, None),
        (6.0, 6.3, 6.01, 6),
        (8.0, 6.3, 6.3, None),
        (8.0, 6.3, 6.31, 6.3),
    ],
)
def test_how_long_a_pulse_may_be(longest, cutoff, length, most):
    """Shorter than the rig's limit and than its cut-off; the longest pulse counts."""
    rig = weak(limits={"max_on_s": longest}, cutoff={"kind": "timer", "max_on_s": cutoff})
    assert limits.max_pulse(rig) == min(longest, cutoff)
    made = schedule(30.0, (1, 0.0, length), (2, 10.0, 1.0))
    if most is None:
        limits.check_schedule(made, rig)
    else:
        refused("long-pulse", made, rig, f"at most {most} s; found {length:g} s")


def test_without_a_timer_the_limit_alone_counts():
    values = weak().model_dump()
    for cutoff in (None, {"kind": "thermal", "opens_at_c": 80.0}):
        assert limits.max_pulse(Rig.from_json(values | {"cutoff": cutoff})) == 6.0


@pytest.mark.parametrize(
    ("pulses", "gap"),
    [
        ([(1, 0.0, 2.0), (1, 10.0, 2.0)], None),
        ([(1, 0.0, 2.0), (1, 9.99, 2.0)], "7.99"),
        ([(1, 0.0, 2.0), (1, 10.01, 2.0)], "7.99"),  # from the last pulse to the next period's first
        ([(1, 15.0, 3.0), (2, 0.0, 1.0)], None),
        ([(1, 0.0, 2.0), (2, 3.0, 2.0)], None),  # another channel's
        ([(1, 19.0, 2.0), (1, 9.0, 2.0)], None),
        ([(1, 19.0, 2.0), (1, 8.9, 2.0)], "7.9"),
    ],
)
def test_the_shortest_gap_of_a_channel(pulses, gap):
    made = schedule(20.0, *pulses)
    if gap is None:
        limits.check_schedule(made, weak())
    else:
        refused("no-rest", made, weak(), f"channel 1 .*at least 8 s; found {gap}")


def test_a_gap_of_a_single_pulse_is_to_its_own_next_start():
    limits.check_schedule(schedule(10.0, (1, 1.0, 2.0)), weak())
    refused("no-rest", schedule(9.99, (1, 1.0, 2.0)), weak())


@pytest.mark.parametrize(("duty", "allowed"), [(0.3, True), (0.299, False)])
def test_the_duty_of_a_channel_is_the_sum_of_its_pulses(duty, allowed):
    made = schedule(20.0, (1, 0.0, 4.0), (1, 12.0, 2.0), (2, 0.0, 3.0))
    rig = weak(limits={"duty": duty, "min_off_s": 6.0})
    if allowed:
        limits.check_schedule(made, rig)
    else:
        refused("duty", made, rig, "channel 1 .*at most 0.299 of any 60 s; found 18 s")


@pytest.mark.parametrize(
    ("starts", "allowed"),
    [
        ((0.0, 0.0, 3.0), True),
        ((0.0, 0.0, 0.0), False),
        ((0.0, 1.0, 1.9), False),  # the third begins while both others heat
        ((0.0, 1.0, 2.0), True),  # as the first ends
        ((19.0, 0.0, 0.5), False),  # over the period's end
        ((1.9, 1.0, 0.0), False),
    ],
)
def test_how_many_springs_heat_at_once(starts, allowed):
    made = schedule(20.0, *((c, start, 2.0) for c, start in zip((1, 2, 3), starts, strict=True)))
    if allowed:
        limits.check_schedule(made, weak())
    else:
        refused("supply", made, weak(), "at most 2.1 A; found 3 x 1.05 A")


@pytest.mark.parametrize(
    ("channel", "place", "told"),
    [
        (2, (0, "front"), "channel 2 of the rig does not heat spring 0 front; expected channel 1"),
        (1, (5, "front"), "channel 1 .* spring 5 front; expected a spring that this rig heats"),
    ],
)
def test_a_schedule_for_another_wiring(channel, place, told):
    events = (Event(0.0, *place, channel, True), Event(2.0, *place, channel, False))
    refused("other-wiring", ActuationSchedule(20.0, events=events), weak(), told)


def test_a_rig_that_must_not_heat_has_no_schedule():
    refused("contact-rating", schedule(20.0, (1, 0.0, 2.0)), weak(board={"contact_rating_a": 0.5}))
    timed = weak(board={"kind": "modbus", "retriggerable": None})
    refused("unknown-timer", schedule(20.0, (1, 0.0, 2.0)), timed)


# Temperatures, against the heat model on a finer grid.


def peak(rig: Rig, period: float, *pulses: tuple[int, float, float], longer: float = 0.0) -> float:
    """Highest temperature of the worst springs until it repeats [C]."""
    times = np.arange(round(period / DT)) * DT
    channels = sorted({c for c, _, _ in pulses})
    on = np.zeros((len(times), len(channels)))
    for channel, start, length in pulses:
        on[(times - start) % period < length + longer - 1e-9, channels.index(channel)] = 1.0
    return float(heat(np.tile(on, (PERIODS, 1)), DT, worst_springs(rig)).temperature.max())


TRAINS = {
    "one pulse": (14.0, (1, 0.0, 5.5)),
    "over the end of the period": (14.0, (1, 11.33, 5.5)),
    "two channels": (14.0, (1, 0.0, 2.0), (3, 7.77, 5.5)),
    "hotter from period to period": (10.0, (1, 0.0, 2.0)),
    "two pulses of a channel": (17.0, (1, 0.0, 5.0), (1, 9.0, 2.0)),
    "the first pulse of a channel begins hotter": (17.0, (1, 0.0, 2.0), (1, 8.0, 5.0)),
}


@pytest.mark.parametrize("name", TRAINS)
def test_the_predicted_peak(name):
    period, *pulses = TRAINS[name]
    rig = rig_with(limits={"min_off_s": 4.0}, supply={"current_limit_a": 3.1})
    prediction = limits.check_schedule(schedule(period, *pulses), rig)
    assert prediction.peak_c == pytest.approx(peak(rig, period, *pulses), abs=0.3)
    assert prediction.peak_c == round(prediction.peak_c, 2)


def test_a_peak_at_the_ceiling_is_refused():
    """Of the schedule as planned, and with every pulse one step of a board's timer longer."""
    period, pulse = 14.0, (1, 0.0, 5.5)
    values = rig_with(supply={"current_limit_a": 3.4}).model_dump() | {
        "cutoff": {"kind": "thermal", "opens_at_c": 60.5}
    }
    rig = Rig.from_json(values)
    planned, longer = peak(rig, period, pulse), peak(rig, period, pulse, longer=0.1)
    assert longer > planned + 0.5

    def below(ceiling: float) -> Rig:
        return rig.model_copy(update={"limits": rig.limits.model_copy(update={"max_temperature_c": ceiling})})

    made = schedule(period, pulse)
    assert limits.check_schedule(made, below(longer + 0.2)).peak_c < longer
    refused("too-hot", made, below((planned + longer) / 2), "one step of 0.1 s longer")
    said = r"the springs would get too hot; expected at most [0-9.]+ C; found [0-9.]+ C predicted"
    refused("too-hot", made, below(planned - 0.2), said)


def test_springs_that_share_are_cooler_together():
    """Two on one output, at the same time and one after the other."""
    rig = rig_with(supply={"outputs": "shared", "current_limit_a": 4.0, "max_total_current_a": 4.2})
    rig = Rig.from_json(rig.model_dump() | {"cutoff": {"kind": "thermal", "opens_at_c": 85.0}})
    together = limits.check_schedule(schedule(20.0, (1, 0.0, 3.8), (3, 0.0, 3.8)), rig).peak_c
    apart = limits.check_schedule(schedule(20.0, (1, 0.0, 3.8), (3, 10.0, 3.8)), rig).peak_c
    worst = worst_springs(rig)
    part = power_shares(rig, worst, worst=True)[2]
    on = np.where(np.arange(1000) < 190, part, 0.0)
    assert together == pytest.approx(heat(np.tile(on, 3)[:, None], DT, worst).temperature.max(), abs=0.2)
    assert apart > together + 20.0


# A contact welded shut at the worst moment.


@pytest.mark.parametrize("name", TRAINS)
@pytest.mark.parametrize("current", [3.1, 3.4])
def test_a_contact_that_welds_at_the_hottest_start(name, current):
    """Until the timer opens: from the state that the spring has when its pulse begins, the hottest one."""
    period, *pulses = TRAINS[name]
    rig = rig_with(limits={"min_off_s": 4.0}, supply={"current_limit_a": current})
    worst = worst_springs(rig)
    hottest = 0.0
    times = np.arange(round(PERIODS * period / DT)) * DT
    for channel in {c for c, _, _ in pulses}:
        own = [(s, n) for c, s, n in pulses if c == channel]
        on = np.any([(times - s) % period < n - 1e-9 for s, n in own], axis=0)
        history = heat(on[:, None].astype(float), DT, worst)
        for start, _ in own:
            k = round(((PERIODS - 1) * period + start) / DT) - 1
            state = SpringState(history.temperature[k], history.martensite[k])
            held = HeatModel([worst]).run(np.ones((315, 1)), DT, state)
            hottest = max(hottest, float(held.temperature.max()))
    if hottest > 90.0:
        refused("stuck-contact", schedule(period, *pulses), rig, "cut-off")
    else:
        stuck = limits.check_schedule(schedule(period, *pulses), rig).stuck_c
        assert stuck == pytest.approx(hottest, abs=0.4) and stuck == round(stuck, 2)


def test_a_cold_spring_without_a_schedule():
    rig = rig_with()
    worst = worst_springs(rig)
    held = HeatModel([worst]).run(np.ones((630, 1)), 0.01)
    assert stuck_temperature(rig, worst, None) == pytest.approx(held.temperature.max(), abs=0.1)


@pytest.mark.parametrize("second", [8.0, 1.0], ids=["apart", "overlapping"])
def test_behind_a_contactor_a_welded_spring_heats_with_any_other(second):
    values = rig_with(board={"kind": "modbus", "retriggerable": True, "channels": 5}).model_dump()
    rig = Rig.from_json(values | {"cutoff": {"kind": "contactor", "channel": 5}})
    made = schedule(20.0, (1, 0.0, 2.0), (3, second, 2.0))
    worst = worst_springs(rig)
    times = np.arange(1000) * DT
    on = (times % 20.0 < 2.1 - 1e-9) | ((times >= second) & (times < second + 2.1 - 1e-9))
    expected = heat(np.tile(on, 4)[:, None].astype(float), DT, worst).temperature.max()
    prediction = limits.check_schedule(made, rig)
    assert prediction.stuck_c == pytest.approx(expected, abs=0.4) and prediction.stuck_c > prediction.peak_c
    assert stuck_temperature(rig, worst, None) == worst.ambient
