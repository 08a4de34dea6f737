"""What a player orders of a bank, and when; on a bank that only notes it."""

from dataclasses import replace

import pytest

from eldir.errors import EldirError
from eldir_hardware.clock import VirtualClock
from eldir_hardware.guardian.bank import LEAD, HeaterBank, Report, ignore_report
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.run.player import READY, Player
from eldir_hardware.safety import limits
from eldir_hardware.safety.stop_signals import StoppedError
from tests.hardware.rigs_and_schedules import RIG, gait
from tests.hardware.virtual.piston_and_observer import Notes

SCHEDULE = replace(compile_schedule(gait(), RIG, cycles=2), settle_s=3.0, conditioning_cycles=1)


class Noting(HeaterBank):
    """Notes orders with their time, and reports every 0.05 s."""

    def __init__(self, clock: VirtualClock):
        self.clock = clock
        self.told: list[tuple[str, float]] = []
        self.pulses: list[tuple[float, float, dict[int, float]]] = []
        self.silent = False

    def arm(self) -> None:
        self.told.append(("arm", self.clock.now()))

    def heat(self, at, lengths) -> None:
        self.pulses.append((self.clock.now(), at, dict(lengths)))

    def abort_pulses(self) -> None:
        self.told.append(("cut", self.clock.now()))

    def wait_until(self, t, see=ignore_report) -> None:
        assert t <= self.clock.now() + 0.1 + 1e-9, "a key is noticed within a tenth of a second"
        self.clock.sleep_until(t)
        if not self.silent:
            see(Report(self.clock.now(), (True, False), (50.0, 22.0), 70.126, 0.01))

    def disarm(self) -> None:
        self.told.append(("disarm", self.clock.now()))

    def stop(self, why) -> None:
        self.told.append((f"stop: {why}", self.clock.now()))


@pytest.fixture
def bench(monkeypatch):
    """A schedule is checked once, below: it takes a second."""
    monkeypatch.setattr(limits, "check_schedule", lambda schedule, rig: limits.HeatPrediction(80.0, 85.0))
    clock, notes = VirtualClock(), Notes()
    clock.sleep_until(99.0)
    bank = Noting(clock)
    return clock, bank, notes, Player(bank, SCHEDULE, RIG, clock, [notes])


def at(clock: VirtualClock, t: float, action) -> None:
    clock.call_at(t, lambda _: action())


def test_a_run_begins_when_its_first_pulses_can_be_announced_in_time(bench):
    _, _, _, player = bench
    starts = []
    player.play(on_start=starts.append)
    assert starts == [pytest.approx(99.0 + LEAD + 0.2)]


@pytest.mark.parametrize("start", [0.0, 110.0])
def test_every_pulse_is_announced_once_just_in_time(bench, start):
    clock, bank, notes, player = bench
    played = player.play(start)
    begin = max(99.0 + READY, start)
    wanted = [
        (begin + 3.0 + 20.0 * cycle + p, {c: pytest.approx(5.5) for c in channels})
        for cycle in range(3)
        for p, channels in ((0.0, (1, 2)), (10.0, (3, 4)))
    ]
    assert [(a, lengths) for _, a, lengths in bank.pulses] == [(pytest.approx(t), x) for t, x in wanted]
    for now, t, _ in bank.pulses:
        assert LEAD - 1e-6 <= t - now <= LEAD + 0.11
    assert [name for name, _ in bank.told] == ["arm", "disarm"]
    assert clock.now() == pytest.approx(begin + SCHEDULE.duration, abs=0.11)
    assert played.duration_s == pytest.approx(SCHEDULE.duration, abs=0.11)
    assert played.ended == "played to the end"
    assert (played.peak_c, played.max_delay_s) == (70.13, 0.01)
    assert notes.events == []
    assert notes.relays[0][1] == (True, False) and notes.temperatures[0][1] == (50.0, 22.0)
    times = [t for t, _ in notes.relays]
    assert times == [t for t, _ in notes.temperatures] == sorted(times)
    assert times[-1] == pytest.approx(SCHEDULE.duration, abs=0.11), "counted from the start"


def test_a_bank_that_never_reports(bench):
    _, bank, _, player = bench
    bank.silent = True
    played = player.play()
    assert (played.peak_c, played.max_delay_s) == (RIG.springs.ambient_c, 0.0)


def test_a_pause_cuts_at_once_and_the_cycle_begins_again_when_the_next_would_have(bench):
    clock, bank, notes, player = bench
    at(clock, 125.0, player.pause)  # in the second cycle, which began at 123
    at(clock, 127.0, player.resume)
    player.play(100.0)
    (cut,) = [t for name, t in bank.told if name == "cut"]
    assert 125.0 <= cut <= 125.11
    begins = [a for _, a, lengths in bank.pulses if 1 in lengths]
    assert begins == pytest.approx([103.0, 123.0, 143.0, 163.0])
    assert [text for _, text in notes.events] == [
        "paused in cycle 2",
        "resumed: cycle 2 begins again at 43.0 s",
    ]
    assert notes.events[0][0] == pytest.approx(cut - 100.0)
    assert not player.paused


@pytest.mark.parametrize(("paused", "begin"), [(101.0, 103.0), (102.65, 103.0), (102.75, 123.0)])
def test_a_cycle_of_which_nothing_was_heated_need_not_wait(bench, paused, begin):
    """The first cycle begins at 103; what was announced may have begun."""
    clock, bank, _, player = bench
    at(clock, paused, player.pause)
    at(clock, paused + 0.11, player.resume)
    player.play(100.0)
    begins = [a for _, a, lengths in bank.pulses if 1 in lengths and a >= paused + 0.3]
    assert begins[0] == pytest.approx(max(begin, paused + 0.11 + 2 * LEAD), abs=0.11)


def test_a_long_pause_goes_on_in_time_for_the_next_announcement(bench):
    clock, bank, _, player = bench
    at(clock, 125.0, player.pause)
    at(clock, 150.0, player.resume)
    at(clock, 140.0, lambda: bank.told.append(("paused" if player.paused else "not paused", 140.0)))
    player.play(100.0)
    begins = [a for _, a, lengths in bank.pulses if 1 in lengths]
    assert begins[2] == pytest.approx(150.0 + 2 * LEAD, abs=0.11)
    assert ("paused", 140.0) in bank.told
    assert not [a for _, a, _ in bank.pulses if 125.2 < a < 150.0]


def test_one_step_plays_one_cycle_and_pauses(bench):
    clock, bank, notes, player = bench
    at(clock, 101.0, player.pause)
    at(clock, 102.0, player.step)
    at(clock, 160.0, player.resume)
    player.play(100.0)
    assert [text.split(" at ")[0] for _, text in notes.events] == [
        "paused in cycle 1",
        "resumed: cycle 1 begins again",
        "paused in cycle 2",
        "resumed: cycle 2 begins again",
    ]
    begins = [a for _, a, lengths in bank.pulses if 1 in lengths]
    assert len(begins) == 3, "none was begun twice"
    assert begins[0] + 20.0 <= notes.events[2][0] + 100.0 <= begins[0] + 20.11, "after the whole cycle"
    assert begins[1] == pytest.approx(160.0 + 2 * LEAD, abs=0.11)


def test_a_pause_before_the_end_of_the_last_cycle_plays_it_again(bench):
    clock, bank, _, player = bench
    at(clock, 162.0, player.pause)
    at(clock, 163.0, player.resume)
    player.play(100.0)
    assert len([1 for _, _, lengths in bank.pulses if 1 in lengths]) == 4


def test_a_pause_when_nothing_is_left_does_not_hold_up_the_end(bench):
    clock, _, notes, player = bench
    at(clock, 162.85, player.pause)  # the last 0.3 s
    player.play(100.0)
    assert clock.now() < 164.0 and notes.events == []


@pytest.mark.parametrize("paused", [False, True])
def test_finish_ends_without_a_stop(bench, paused):
    clock, bank, _, player = bench
    if paused:
        at(clock, 120.0, player.pause)
    at(clock, 125.0, player.finish)
    played = player.play(100.0)
    assert bank.told[-1][0] == "disarm" and bank.told[-1][1] <= 125.11
    assert played.duration_s == pytest.approx(25.0, abs=0.11)
    assert played.ended == f"finished after {0 if paused else 1} of 3 cycles"


def test_finish_cycle_plays_the_cycle_to_its_end(bench):
    clock, bank, _, player = bench
    at(clock, 125.0, player.finish_cycle)  # in the second cycle of three, which began at 123
    played = player.play(100.0)
    assert [a for _, a, lengths in bank.pulses if 1 in lengths] == pytest.approx([103.0, 123.0])
    assert bank.told[-1][0] == "disarm" and 143.0 <= bank.told[-1][1] <= 143.11
    assert played.ended == "finished after 2 of 3 cycles"


def test_finish_cycle_before_the_first_cycle_plays_that_one(bench):
    _, bank, _, player = bench
    player.finish_cycle()
    assert player.play(100.0).ended == "finished after 1 of 3 cycles"
    assert [a for _, a, lengths in bank.pulses if 1 in lengths] == pytest.approx([103.0])


def test_finish_cycle_ends_a_pause_at_once(bench):
    clock, bank, _, player = bench
    at(clock, 125.0, player.pause)
    at(clock, 130.0, player.finish_cycle)
    assert player.play(100.0).ended == "finished after 1 of 3 cycles"
    assert bank.told[-1][0] == "disarm" and bank.told[-1][1] <= 130.11


@pytest.mark.parametrize("paused", [False, True])
def test_a_stop_is_a_stop(bench, paused):
    clock, bank, _, player = bench
    if paused:
        at(clock, 120.0, player.pause)
    at(clock, 125.0, lambda: player.stop("a key"))
    with pytest.raises(StoppedError, match="a key"):
        player.play(100.0)
    assert bank.told[-1][0] == "stop: a key" and bank.told[-1][1] <= 125.11


def test_a_schedule_that_the_rig_refuses_is_not_taken():
    clock = VirtualClock()
    with pytest.raises(EldirError, match="too hot"):
        Player(Noting(clock), SCHEDULE, RIG.model_copy(update={"fan": None}), clock)


def test_a_schedule_that_the_rig_takes():
    clock = VirtualClock()
    prediction = Player(Noting(clock), SCHEDULE, RIG, clock).prediction
    assert 70 < prediction.peak_c < prediction.stuck_c < 90


def test_the_first_pulses_can_be_announced_in_time(bench):
    """There is time between being armed and the announcement of what begins at the start itself."""
    assert READY >= LEAD + 0.1


def test_pulses_are_announced_in_the_order_of_time(bench):
    """Also where a channel with a higher number heats first."""
    clock, bank, notes, _ = bench
    schedule = replace(compile_schedule(gait(phase=(0.5, 0.0)), RIG, cycles=2), settle_s=3.0)
    Player(bank, schedule, RIG, clock, [notes]).play()
    begins = [at for _, at, _ in bank.pulses]
    assert len(begins) > 2 and begins == sorted(begins)
    assert all(at - told >= LEAD - 1e-6 for told, at, _ in bank.pulses)


def test_springs_that_are_still_warm_rest_first(bench):
    """Nothing of that reaches the observers: the schedule has not begun."""
    clock, bank, notes, player = bench
    bank.ready_at = 120.0
    rests, starts = [], []
    player.play(0.0, starts.append, rests.append)
    assert rests == [pytest.approx(120.0 - 99.0)] and starts == [pytest.approx(120.0, abs=0.11)]
    assert bank.pulses[0][1] == pytest.approx(starts[0] + SCHEDULE.settle_s)
    assert min(t for t, _ in notes.relays) >= 0.0 - READY
    rests.clear()
    player = Player(bank, SCHEDULE, RIG, clock, [notes])
    player.play(0.0, starts.append, rests.append)
    assert rests == [], "they have rested"


def test_a_key_stops_while_springs_rest(bench):
    clock, bank, _, player = bench
    bank.ready_at = 150.0
    clock.call_at(105.0, lambda t: player.stop("a key"))
    with pytest.raises(StoppedError, match="a key"):
        player.play()
    assert clock.now() == pytest.approx(105.0, abs=0.11) and bank.pulses == []
