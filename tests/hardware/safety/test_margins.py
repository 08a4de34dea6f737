"""What is left beyond a rig file's tolerances, and how a schedule, the planner and the command tell it."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
import yaml

from eldir.built.heat import HeatModel, heat
from eldir_hardware.guardian._interlock import Interlock
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.plan import find_timing
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import coldest_springs, worst_springs
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.safety.limits import LimitError, check_heat, check_schedule, max_on_time
from eldir_hardware.safety.margins import (
    _largest_allowed,
    coldest_peak_and_stroke,
    describe_margins,
    heat_margins,
    rigs_with_narrower_tolerances,
)
from eldir_hardware.safety.worst_heat import run_until_periodic
from eldir_hardware.schedule import ActuationSchedule, HeatMargins, SchedulePrediction
from tests.hardware.rigs_and_schedules import RIG, SCHEDULE, gait, measured, rig_with
from tests.hardware.safety.replayed_heat import HOTTEST, peak, wire
from tests.paths import SCHEMAS
from tests.raised import raises

THERMAL = {"kind": "thermal", "opens_at_c": 89.0}


def thermal(**changes: object) -> Rig:
    """A rig whose limits are not those of a timer."""
    return Rig.from_json(rig_with(**changes).model_dump() | {"cutoff": THERMAL})


LOW = thermal(supply={"current_limit_a": 3.3})


@pytest.fixture(scope="module")
def margins() -> HeatMargins:
    return heat_margins(SCHEDULE, LOW)


def test_the_margins_end_at_the_ceiling(margins):
    """By the independent model: with the margin used up a spring is at 90 C, and below it before."""
    pulses = {1: [(20.0 * k, 20.0 * k + 5.5 + 0.1) for k in range(4)]}  # a step longer than scheduled
    worst = wire(LOW, HOTTEST)
    assert peak(pulses, worst) < 85
    for changed in (
        {"current": worst.current + margins.current_a},
        {"ambient": worst.ambient + margins.ambient_c},
    ):
        assert peak(pulses, worst.__class__(**vars(worst) | changed)) == pytest.approx(90, abs=0.6)
    longer = {1: [(a, b + margins.longer_s) for a, b in pulses[1]]}
    assert peak(longer, worst) == pytest.approx(90, abs=0.6)
    assert margins.coldest_c < 55 and 0.1 < margins.coldest_stroke < 0.5
    planned = (np.arange(5000) * 0.02 % 20.0 < 5.5)[:, None].astype(float)  # not a step longer
    found = heat(planned, 0.02, coldest_springs(LOW))
    assert margins.coldest_c == pytest.approx(found.temperature.max(), abs=0.3)


def test_margins_are_as_exact_as_they_are_said_to_be(margins):
    """Allowed with the whole margin used up, refused 0.01 A, 0.1 K or 0.02 s beyond (and their rounding)."""
    pulses, period = SCHEDULE.pulses(), SCHEDULE.period_s
    nominal = float(LOW.spring_parameters().current(0.0))

    def allowed(current: float = 0.0, ambient: float = 0.0, longer: float = 0.0) -> bool:
        wider = LOW.tolerances.model_copy(
            update={
                "current": LOW.tolerances.current + current / nominal,
                "ambient_max_c": LOW.tolerances.ambient_max_c + ambient,
            }
        )
        try:
            check_heat(pulses, period, LOW.model_copy(update={"tolerances": wider}), longer)
        except LimitError:
            return False
        return True

    for name, margin, exact in (
        ("current", margins.current_a, 0.01),
        ("ambient", margins.ambient_c, 0.1),
        ("longer", margins.longer_s, 0.02),
    ):
        assert allowed(**{name: max(margin - 0.005, 0.0)}), name
        assert not allowed(**{name: margin + exact + 0.005}), name


@pytest.mark.parametrize(
    ("rig", "period", "most"),
    [
        (RIG, 20.0, 0.01),
        (rig_with(fan=None, supply={"current_limit_a": 2.0}), 60.0, 0.2),
    ],
    ids=["fan", "still air"],
)
def test_a_neighbour_adds_little_to_the_peak_that_the_limits_are_checked_with(rig, period, most):
    """Limits are checked for springs by themselves, whatever a rig file says; docs/safety.md tells what that
    leaves out. 2e-4 W/K is what docs/reference/built.md estimates."""
    assert rig.spring_parameters().neighbour_conductance == 0.0
    worst, hubs = worst_springs(rig), np.array([[0, 1], [1, 2]])
    assert worst.neighbour_conductance == 0.0
    passes, times, added = replace(worst, neighbour_conductance=2e-4), np.arange(0, 6 * period, 0.05), []
    for phase in (0.2, 0.5, 0.7):
        on = np.stack([(times - begin) % period < 4.5 for begin in (0.0, phase * period)], axis=1)
        coupled, alone = heat(on, 0.05, passes, hubs=hubs), heat(on, 0.05, worst)
        added.append(coupled.temperature.max() - alone.temperature.max())
    assert min(added) > -0.01 and 0.0 < max(added) < most


def test_margins_are_searched_up_to_2_amperes_40_degrees_and_6_seconds():
    """Half a second at 1 A leaves more than anybody needs."""
    weak = thermal(supply={"current_limit_a": 1.0})
    found = heat_margins(compile_schedule(gait(duty=(0.025, 0.025)), weak), weak)
    assert (found.current_a, found.ambient_c, found.longer_s) == (2.0, 40.0, 6.0)


def test_the_coldest_corner_is_told_of_the_spring_that_moves_least():
    """The peak is that of the longer pulse, the part of the stroke that of the shorter one."""
    both, long, short = (
        coldest_peak_and_stroke(compile_schedule(gait(duty=duty), LOW), LOW)
        for duty in ((0.275, 0.2), (0.275, 0.0), (0.2, 0.0))
    )
    assert both == (long[0], short[1]) and long[0] > short[0] + 1 and long[1] > short[1] + 0.05


def test_margins_are_told_with_the_digits_that_they_have(margins):
    digits = {"current_a": 2, "ambient_c": 2, "longer_s": 2, "coldest_c": 1, "coldest_stroke": 3}
    assert all(getattr(margins, name) == round(getattr(margins, name), n) for name, n in digits.items())


def test_margins_are_written_into_the_schedule_and_said(margins):
    values = SCHEDULE.to_json()
    values["predicted"]["margins"] = margins.to_json()
    jsonschema.validate(values, json.loads((SCHEMAS / "schedule.schema.json").read_text()))
    again = ActuationSchedule.from_json(values)
    assert again.predicted.margins == margins and again.to_json() == values
    assert SchedulePrediction.from_json({}).margins is None
    said = describe_margins(margins, LOW)
    assert f"{margins.current_a:.2f} A more current" in said and "hotter than 30 C" in said


@pytest.mark.parametrize(
    "changes",
    [
        {"current": 0.1},
        {"ambient_max_c": 36.0},
        {"convection_tolerance": 0.25},
    ],
)
def test_every_tolerance_counts_for_schedule_and_guardian(changes):
    """A wider one alone makes the same schedule, and the same pulses of the guardian, too hot."""
    narrow, wide = rig_with(), rig_with(tolerances=changes)
    pulses = compile_schedule(gait(), narrow).pulses()
    check_heat(pulses, 20.0, narrow)
    with pytest.raises(LimitError, match=r"too hot|cut-off would act too late"):
        check_heat(pulses, 20.0, wide)
    Interlock(narrow, 0.0).check_pulses(0.3, {1: 6.0})
    guardian = Interlock(wide, 0.0) if _arms(wide) else None
    if guardian is not None:
        assert worst_springs(wide).power(0.0) >= worst_springs(narrow).power(0.0)
        first = guardian._state.temperature[len(wide.channels) :]
        assert (first == wide.tolerances.ambient_max_c).all(), (
            "the model of the guardian begins in the same corner"
        )


def _arms(rig: Rig) -> bool:
    try:
        Interlock(rig, 0.0)
    except LimitError:
        return False
    return True


def test_a_fan_counts_only_with_its_interlock():
    assert worst_springs(rig_with()).fan
    assert not worst_springs(rig_with(fan={"interlocked": False})).fan


def test_former_rig_files_are_refused_with_the_temperature():
    """4 A and a timer of 6.3 s: what version 0.1.0 wrote."""
    text = virtual_rig().replace(
        "current_limit_a: 3.45, max_total_current_a: 16", "current_limit_a: 4, max_total_current_a: 20"
    )
    with raises(LimitError, "limit.too-hot", match=r"at most 90 C; found (9|10)\d"):
        compile_schedule(gait(duty=(0.3, 0.3)), Rig.from_json(yaml.safe_load(text)))


def test_the_planner_stays_within_the_worst_corner():
    """At 4 A the whole heating is too hot after the shortest pause; with longer pauses it is not."""
    for rig in (rig_with(), thermal(supply={"current_limit_a": 4.0, "max_total_current_a": 20})):
        period, duty = find_timing(rig.spring_parameters(), rig, 2)
        compile_schedule(gait(duty=(duty, duty), period=period), rig)
        assert 15 < period < 45 and 3.0 < duty * period <= rig.limits.max_on_s


@pytest.mark.parametrize("duty", [0.15, 0.2, 0.25, 0.5])
def test_the_planner_keeps_the_duty_of_any_minute(duty):
    rig = rig_with(limits={"duty": duty})
    period, part = find_timing(rig.spring_parameters(), rig, 2)
    assert max_on_time([(period * k, period * (k + part)) for k in range(8)]) <= 60 * duty + 1e-6
    compile_schedule(gait(duty=(part, part), period=period), rig)


def test_the_time_in_a_minute_counts_wherever_it_begins():
    assert max_on_time([]) == 0
    assert max_on_time([(0, 10), (55, 61)]) == 15, "from 0 to 60 as from 1 to 61"
    assert max_on_time([(0, 1), (50, 60), (62, 72)]) == 20
    assert max_on_time([(0, 100)]) == 60


def test_short_periods_are_followed_until_they_repeat_too():
    """In still air a spring warms up for minutes: 0.5 s in 5 s, against the balance of mean heat and loss."""
    still = {"fan": None, "springs": measured(convection_still=40.0), "supply": {"current_limit_a": 3.0}}
    rig = rig_with(**still)
    worst = worst_springs(rig)
    on = np.zeros((100, 1))
    on[:10] = 1.0
    history = run_until_periodic(on, 0.05, worst, 200.0)
    mean = float(history.temperature.mean())
    assert mean == pytest.approx(worst.ambient + 0.1 * float(worst.power(0.0)) / worst.loss, abs=0.3)


def test_the_last_value_for_which_something_holds():
    assert _largest_allowed(lambda x: True, 3.0, 0.01) == 3.0
    assert _largest_allowed(lambda x: False, 3.0, 0.01) == 0.0
    found = _largest_allowed(lambda x: x <= 2.0, 3.0, 0.01)
    assert 1.99 <= found <= 2.0


@pytest.mark.parametrize("parts", [1, 5])
def test_a_short_period_is_followed_as_long_as_a_long_one(parts):
    """Heat that repeats every second, and the same with five of these as one period: the same peak."""
    springs = replace(worst_springs(rig_with()), fan=False)
    on = np.zeros((20, 1))
    on[:1] = 1.0
    history = run_until_periodic(np.tile(on, (parts, 1)), 0.05, springs, 1e9)
    longest = run_until_periodic(np.tile(on, (30, 1)), 0.05, springs, 1e9)
    assert len(history.temperature) == 20 * parts
    assert history.temperature.max() == pytest.approx(longest.temperature.max(), abs=0.1)


def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many steps each run of the heat model has from now on."""
    steps: list[int] = []
    run = HeatModel.run
    monkeypatch.setattr(HeatModel, "run", lambda *a: (steps.append(len(a[1])), run(*a))[1])
    return steps


@pytest.mark.parametrize("begin", [0, 5, 30])
def test_heat_is_followed_until_it_repeats_and_no_longer(begin, monkeypatch):
    """Wherever the pulse lies in its period, and beside a spring that is never heated."""
    springs = worst_springs(rig_with())
    on = np.zeros((40, 2))
    on[begin : begin + 6, 1] = 1.0
    steps = counted(monkeypatch)
    history = run_until_periodic(on, 0.05, springs, 90.0)
    assert len(steps) < 12 and set(steps) == {320}, "15 s at least, in whole periods of 2 s"
    long = HeatModel([springs]).run(np.tile(on[:, 1:], (100, 1)), 0.05)
    assert history.temperature[:, 1] == pytest.approx(long.temperature[-40:, 0], abs=0.05)
    assert history.current[:, 1] == pytest.approx(long.current[-40:, 0], abs=1e-6)
    assert (history.temperature[:, 0] == springs.ambient).all()


def test_a_long_period_is_compared_with_the_one_before(monkeypatch):
    steps = counted(monkeypatch)
    on = np.zeros((400, 1))
    on[:20] = 1.0
    run_until_periodic(on, 0.05, worst_springs(rig_with()), 90.0)
    assert set(steps) == {400}


def test_what_is_far_too_hot_is_not_followed_further(monkeypatch):
    springs = worst_springs(rig_with())
    steps = counted(monkeypatch)
    on = np.zeros((40, 2))
    on[:30, 1] = 1.0
    assert run_until_periodic(on, 0.05, springs, 50.0).temperature.max() > 55 and len(steps) == 1


@pytest.mark.parametrize("rig", [LOW, rig_with()], ids=["thermal", "timer"])
def test_measured_values_allow_the_highest_current_that_keeps_the_limits(rig):
    """By the independent model: below 90 C in their worst corner, and the next step is refused."""
    schedule, own = compile_schedule(gait(duty=(0.27, 0.27)), rig), rig.supply.current_limit_a
    found = list(rigs_with_narrower_tolerances(schedule, rig))
    currents = [other.supply.current_limit_a for other in found]
    assert len(found) == 3 and own < min(currents) and max(currents) == currents[2] <= own + 0.8
    for other, current in zip(found, currents, strict=True):
        assert current == round(20 * current) / 20
        allowed = other.tolerances
        corner = HOTTEST._replace(ambient=allowed.ambient_max_c, current=1 + allowed.current)
        pulses = {1: [(20.0 * k, 20.0 * k + 5.5) for k in range(4)]}  # a step longer than scheduled
        assert peak(pulses, wire(other, corner)) < 90.1
        with pytest.raises(LimitError):
            supply = other.supply.model_copy(update={"current_limit_a": current + 0.05})
            check_schedule(schedule, other.model_copy(update={"supply": supply}))


def test_nothing_is_advised_that_is_known_or_of_no_use():
    schedule = compile_schedule(gait(duty=(0.1, 0.1)), RIG)
    known = rig_with(tolerances={"current": 0.02, "ambient_min_c": 20.0, "ambient_max_c": 24.0})
    assert list(rigs_with_narrower_tolerances(schedule, known)) == []
    by_voltage = rig_with(supply={"voltage_v": 3.5})
    assert list(rigs_with_narrower_tolerances(schedule, by_voltage)) == []
