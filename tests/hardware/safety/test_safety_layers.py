"""Each layer of docs/safety.md alone: what it stops when all layers above it are gone.

Every test has a twin in it: the same fault with the layer taken out passes the ceiling or leaves the
contact closed, so that none can be lost unseen.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from eldir.built.heat import HeatModel, SpringState
from eldir.errors import EldirError
from eldir_hardware.guardian import pulse_controller
from eldir_hardware.guardian.interlock import Interlock
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.relay.errors import ContactError
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import shares, worst_springs
from eldir_hardware.run.player import Player
from eldir_hardware.safety import limits
from eldir_hardware.safety.limits import LimitError
from eldir_hardware.safety.stuck_contact import stuck_temperature
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.guardian.random_pulse_trains import play_random_train
from tests.hardware.rigs_and_schedules import SCHEDULE, gait, measured, rig_with
from tests.hardware.run.hours_of_a_schedule import hours_of_a_schedule
from tests.hardware.virtual.piston_and_observer import Piston
from tests.raised import raises

TIMED = {"kind": "modbus", "retriggerable": True}


def ignore(report) -> None:
    """Nobody looks."""


def held_on(rig: Rig, seconds: float, count: int = 1) -> float:
    """True temperature of the worst springs, `count` on one supply, with nothing to open their contacts."""
    worst = worst_springs(rig)
    part = shares(rig, worst, worst=True)[count] if rig.supply.outputs == "shared" else 1.0
    on = np.full((round(seconds / 0.05), 1), part)
    return float(HeatModel([worst]).run(on, 0.05).temperature.max())


# Layer 0: a contact that is welded shut.


def test_a_current_that_is_safe_for_ever_and_one_that_is_not():
    """The closed form against the heat model, in the worst corner of still air whose losses were measured."""
    safe = rig_with(
        supply={"current_limit_a": 1.7}, springs=measured(convection_still=50), cutoff=None, fan=None
    )
    steady = stuck_temperature(safe, worst_springs(safe), None)
    assert steady == pytest.approx(held_on(safe, 900), abs=0.05) and steady < 90
    for current in (1.8, 4.0):
        hot = rig_with(
            supply={"current_limit_a": current}, springs=measured(convection_still=50), cutoff=None, fan=None
        )
        assert held_on(hot, 900) > 90
        with raises(LimitError, "limit.stuck-contact"):
            limits.check_rig(hot)


def test_a_fan_that_may_fail_does_not_count():
    windy = rig_with(supply={"current_limit_a": 1.5}, cutoff=None, fan={"interlocked": False})
    with raises(LimitError, "limit.stuck-contact", match="in still air"):
        limits.check_rig(windy)
    assert held_on(windy.model_copy(update={"fan": None}), 900) > 90, "what it guards from"


def test_a_shared_supply_counts_as_if_one_spring_had_it_alone():
    """Four springs share 4 A: each gets one. When three open, the welded one gets all."""
    shared = {"current_limit_a": 4.0, "outputs": "shared"}
    rig = rig_with(supply=shared, springs=measured(convection_still=50), cutoff=None, fan=None)
    assert held_on(rig, 900, count=4) < 90 < held_on(rig, 900, count=1)
    with raises(LimitError, "limit.stuck-contact"):
        limits.check_rig(rig)


@pytest.mark.parametrize(
    ("cutoff", "accepted"),
    [
        ({"kind": "timer", "max_on_s": 6.3}, True),
        ({"kind": "timer", "max_on_s": 7.5}, False),
        ({"kind": "thermal", "opens_at_c": 85.0}, True),
        ({"kind": "thermal", "opens_at_c": 95.0}, False),
        ({"kind": "contactor", "channel": 5}, False),
    ],
)
def test_a_cutoff_counts_only_if_it_acts_in_time_and_outlives_the_host(cutoff, accepted):
    rig = rig_with(board={"channels": 5}).model_copy(update={"cutoff": None})
    rig = Rig.from_json(rig.model_dump() | {"cutoff": cutoff})
    if accepted:
        assert limits.check_schedule(SCHEDULE, rig).stuck_c < 90
    else:
        with pytest.raises(LimitError, match=r"too late|stay closed when this computer dies"):
            limits.check_schedule(SCHEDULE, rig)


def test_a_contactor_that_the_board_itself_opens():
    """It counts on a board that times and restarts pulses, and closes only while something heats."""
    changes = {"board": TIMED | {"channels": 5}, "cutoff": {"kind": "contactor", "channel": 5}}
    values = rig_with(board=changes["board"]).model_dump() | {"cutoff": changes["cutoff"]}
    rig = Rig.from_json(values)
    limits.check_rig(rig)
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with bank.armed():
            bank.heat(1.0, {1: 2.0})
            bank.heat(20.0, {1: 2.0})
            bank.wait_until(21.0, ignore)
            bank.abort_pulses()
            bank.wait_until(22.0, ignore)
        by_channel = {c: [e.t for e in virtual.emulator.edges if e.channel == c] for c in (1, 5)}
    for i in (0, 2):
        (on, off), (master_on, master_off) = by_channel[1][i : i + 2], by_channel[5][i : i + 2]
        assert master_on < on < off <= master_off < off + 0.2


def test_a_contactor_does_not_help_where_other_springs_keep_it_closed():
    """Behind a welded contact a spring heats as long as any other: twice as long where two follow another."""
    entries = {"board": TIMED | {"channels": 5}, "cutoff": {"kind": "contactor", "channel": 5}}
    rig = Rig.from_json(rig_with(board=entries["board"]).model_dump() | {"cutoff": entries["cutoff"]})
    assert compile_schedule(gait(phase=(0.0, 0.0)), rig).predicted.stuck_c < 90
    with raises(LimitError, "limit.stuck-contact", match="contactor"):
        compile_schedule(gait(phase=(0.0, 0.275)), rig)
    long = np.arange(round(5 * 20.0 / 0.05)) * 0.05 % 20.0 < 11.0
    assert HeatModel([worst_springs(rig)]).run(long[:, None], 0.05).temperature.max() > 90


def test_the_contacts_rating():
    with raises(LimitError, "limit.contact-rating"):
        limits.check_rig(rig_with(board={"contact_rating_a": 3.6}))


# Layer 1: pulses that the board times.


def test_a_timed_pulse_ends_when_host_and_guardian_are_gone():
    """The pulse controller stops after the pulse has begun: the board opens, an untimed one does not."""
    for kind, opens in ((TIMED, True), ({"kind": "lcus"}, False)):
        rig = rig_with(board=kind)
        with VirtualRig(rig, Piston()) as virtual:
            bank = PulseController(virtual.board, rig, virtual.clock)
            bank.arm()
            bank.heat(virtual.clock.now() + 0.3, {1: 5.0})
            bank.wait_until(virtual.clock.now() + 2.0, ignore)
            died = virtual.clock.now()
            virtual.clock.sleep_until(died + 5.0)
            assert (virtual.emulator.contacts[0] is False) is opens
            if opens:
                assert max(e.t for e in virtual.emulator.edges) - died < pulse_controller.PULSE + 0.02


def test_pulses_are_refused_until_a_second_flash_is_understood():
    with raises(LimitError, "limit.unknown-timer"):
        limits.check_rig(rig_with(board={"kind": "modbus"}))


def test_a_step_of_the_timer_that_is_too_long_is_refused():
    """A thin wire on a stiff supply: 100 ms more at the end of a pulse would pass the ceiling."""
    thin = rig_with(
        supply={"current_limit_a": 10, "max_total_current_a": 40},
        springs={"wire_diameter_mm": 0.5, "coil_diameter_mm": 5, "resistance_ohm": 2.3},
        board=TIMED | {"contact_rating_a": 16},
        limits={"max_on_s": 0.5, "min_off_s": 8.0},
    )
    values = thin.model_dump() | {"cutoff": {"kind": "thermal", "opens_at_c": 85.0}}
    thin = Rig.from_json(values)
    schedule = SCHEDULE.__class__(
        20.0,
        events=tuple(
            replace(e, t_s=e.t_s if e.on else {5.5: 0.33, 15.5: 10.33}[e.t_s]) for e in SCHEDULE.events
        ),
        cycles=1,
    )
    with raises(LimitError, "limit.too-hot", match=r"one step of 0.1 s longer"):
        limits.check_schedule(schedule, thin)


# Layer 2: the guardian. Its tests with real processes: test_guardian.py, test_faults.py.


@contextmanager
def heating() -> Iterator[tuple[VirtualRig, PulseController]]:
    """In the middle of a pulse, at 1 s on the clock."""
    rig = rig_with()
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        bank.arm()
        bank.heat(0.5, {1: 5.0})
        bank.wait_until(1.0, ignore)
        yield virtual, bank


def test_without_heartbeats_everything_goes_off():
    with heating() as (virtual, bank):
        assert virtual.emulator.contacts[0]
        with pytest.raises(pulse_controller.HeartbeatError):
            while virtual.clock.now() < 4.0:
                virtual.clock.sleep_until(min(bank.step(), virtual.clock.now() + 0.1))
        assert virtual.clock.now() < 1.0 + pulse_controller.PATIENCE + 0.15
        bank.stop("nobody")
        assert not any(virtual.emulator.contacts)


def test_who_stood_still_stops_although_a_heartbeat_lay_in_the_pipe():
    """Between two switchings too, so that no edge is late."""
    with heating() as (virtual, bank):
        virtual.clock.sleep_until(virtual.clock.now() + 0.8)
        bank.beat()
        with raises(EldirError, "guardian.stood-still", match=r"0\.[678] s"):
            bank.step()


# Layer 3: on-times, rests, duty, current.


@pytest.mark.parametrize(
    ("pulses", "code"),
    [
        ([(1.0, {1: 6.2})], "limit.long-pulse"),
        ([(1.0, {1: 1.0}), (5.0, {1: 1.0})], "limit.no-rest"),
        ([(1.0, {1: 1.0, 2: 1.0, 3: 1.0})], "limit.supply"),
        ([(1.0, {1: 2.0, 2: 2.0}), (2.5, {3: 1.0})], "limit.supply"),
        ([(t, {1: 6.0}) for t in (1.0, 15.5, 30.0, 44.5)], "limit.duty"),
    ],
)
def test_what_no_command_may_break(pulses, code):
    """By so weak a current that no temperature forbids anything."""
    rig = rig_with(supply={"current_limit_a": 1.5, "max_total_current_a": 3}, limits={"duty": 0.35})
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with raises(LimitError, code), bank.armed():
            for t, lengths in pulses:
                bank.wait_until(t - 0.3, ignore)
                bank.heat(t, lengths)
            bank.wait_until(pulses[-1][0] + 1.0, ignore)
        assert not any(virtual.emulator.contacts)


def test_the_current_is_checked_again_at_the_edge():
    """Announced 40 ms before another opens, which is as good as after it; but its contact is closed still."""
    rig = rig_with(supply={"max_total_current_a": 4})
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with raises(LimitError, "limit.supply"), bank.armed():
            bank.heat(1.0, {1: 2.0})
            bank.heat(2.96, {2: 1.0})
            bank.wait_until(5.0, ignore)
        assert not any(virtual.emulator.contacts) and {e.channel for e in virtual.emulator.edges} == {1}


def test_a_channel_that_nobody_opens_ends_the_run():
    """Whoever forgets it: what counts is when it was told to close, not for how long it was asked."""
    watch = Interlock(rig_with(supply={"current_limit_a": 1.5}), 0.0)
    watch.switched({2: True}, 0.0)
    watch.check(6.0 + limits.STEP)
    with raises(LimitError, "limit.long-pulse", match="channel 2 .*at most 6 s"):
        watch.check(6.2)


# Layer 4: the model follows what the board reports.


def test_heat_that_nobody_ordered_is_seen_by_the_model():
    """Channel 2 is closed behind our back: neither order nor limit knows of it, only the read-back."""
    rig = rig_with()
    watch = Interlock(rig, 0.0)
    closed = (False, True, False, False)
    with raises(LimitError, "limit.too-hot", match="channel 2 .*at most 90 C"):
        for t in np.arange(0.0, 60.0, 0.1):
            watch.reported(closed, float(t))
            watch.check(float(t))
    assert 5.0 < t < 30.0
    assert 60 < max(watch.temperatures) < 70, "a nominal spring: in the worst corner it is hotter"


def test_a_spring_that_is_too_hot_by_the_model_ends_the_run():
    rig = rig_with()
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with raises(LimitError, "limit.too-hot", match="by the model"), bank.armed():
            bank.heat(0.5, {1: 5.0})
            bank.wait_until(2.0, ignore)
            hot = bank._interlock._state
            bank._interlock._state = SpringState(hot.temperature + 70.0, hot.martensite)
            bank.wait_until(2.5, ignore)
        assert not any(virtual.emulator.contacts) and virtual.clock.now() < 2.6


def test_a_contact_that_closes_by_itself_ends_the_run():
    rig = rig_with()
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with pytest.raises(ContactError, match="channel 2 does not follow"), bank.armed():
            bank.wait_until(1.0, ignore)
            virtual.emulator._set_coil(2, True)
            bank.wait_until(3.0, ignore)
        assert not any(virtual.emulator.contacts) and virtual.clock.now() < 2.5


def test_a_pulse_whose_spring_is_still_hot_is_refused():
    """Each pulse is short and rested, but the springs have not cooled by the model."""
    rig = rig_with(limits={"min_off_s": 1.0, "duty": 1.0, "max_on_s": 4.0})
    watch = Interlock(rig, 0.0)
    now = 0.0
    with raises(LimitError, "limit.too-hot", match="by the model"):
        while now < 60:
            watch.allow(now, {1: 4.0})
            for _ in range(40):
                now += 0.1
                watch.reported((True, False, False, False), now)
            now += 1.1
            watch.reported((False,) * 4, now)


@pytest.mark.parametrize("phase", ["_report", "_command_many"])
def test_standing_still_while_it_waits_for_the_board_is_noticed(monkeypatch, phase):
    """As when the process is suspended in mid-read: the next heartbeat must not hide the gap."""

    def play(virtual: VirtualRig) -> None:
        bank = PulseController(virtual.board, rig, virtual.clock)
        original, left = getattr(virtual.board, phase), [0.8]

        def slow(*arguments: object) -> object:
            answer = original(*arguments)
            if any(virtual.emulator.contacts) and virtual.clock.now() > 2.0 and left:
                virtual.clock.sleep_until(virtual.clock.now() + left.pop())
            return answer

        monkeypatch.setattr(virtual.board, phase, slow)
        with bank.armed():
            bank.heat(1.0, {1: 5.0})
            bank.heat(2.5, {2: 3.0})
            bank.wait_until(6.0, ignore)
        assert not left, "it stood still"

    rig = rig_with()
    with VirtualRig(rig, Piston()) as virtual:
        with raises(EldirError, "guardian.stood-still", match=r"0\.8 s"):
            play(virtual)
        assert not any(virtual.emulator.contacts) and virtual.clock.now() < 4.0
    monkeypatch.setattr(PulseController, "_refuse_standstill", lambda self, since, spared=0.0: since)
    with VirtualRig(rig, Piston()) as virtual:
        play(virtual)  # the twin: without the layer nobody notices


# Layer 5: stops are latched; with processes in test_guardian.py.


def test_a_stopped_pulse_controller_heats_no_more():
    rig = rig_with()
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        bank.arm()
        bank.stop("a key")
        with raises(EldirError, "guardian.stopped", match="a key; reset it first"):
            bank.arm()
        with raises(EldirError, "guardian.stopped", match="a key"):
            bank.heat(1.0, {1: 1.0})


# Layer 6: arming.


def test_it_does_not_arm_without_a_verified_all_off():
    rig = rig_with()
    with VirtualRig(rig, Piston()) as virtual:
        virtual.emulator._set_coil(3, True)
        virtual.emulator.faults.deaf.add(3)
        bank = PulseController(virtual.board, rig, virtual.clock)
        with pytest.raises(EldirError, match="not proven that everything is off"):
            bank.arm()
        with raises(EldirError, "guardian.not-armed"):
            bank.heat(1.0, {1: 1.0})


def test_a_good_end_opens_what_still_heats():
    """A program that leaves in mid-pulse: no error, and yet everything off, proven, the fan too."""
    values = rig_with(board={"channels": 5}).model_dump()
    rig = Rig.from_json(values | {"fan": {"interlocked": True, "channel": 5}})
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with bank.armed():
            bank.heat(1.0, {1: 5.0})
            bank.wait_until(2.0, ignore)
            assert virtual.emulator.contacts == (True, False, False, False, True)
        assert not any(virtual.emulator.contacts) and virtual.clock.now() < 2.5


def test_a_player_takes_no_schedule_that_its_rig_refuses():
    """Even if a bank took each of its pulses."""
    rig = rig_with(limits={"max_temperature_c": 70})
    with VirtualRig(rig_with(), Piston()) as virtual:
        bank = PulseController(virtual.board, rig_with(), virtual.clock)
        with raises(LimitError, "limit.too-hot", match="at most 70 C"):
            Player(bank, SCHEDULE, rig, virtual.clock)


def test_nothing_heats_while_the_fan_is_off():
    values = rig_with(board={"channels": 5}).model_dump()
    rig = Rig.from_json(values | {"fan": {"interlocked": True, "channel": 5}})
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        virtual.emulator.faults.deaf.add(5)
        with pytest.raises(EldirError, match="channel 5 does not follow"), bank.armed():
            bank.wait_until(2.0, ignore)
        assert virtual.emulator.edges == []
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with pytest.raises(EldirError, match="channel 5 does not follow"), bank.armed():
            bank.heat(1.0, {1: 5.0})
            bank.wait_until(2.0, ignore)
            assert virtual.emulator.contacts == (True, False, False, False, True)
            virtual.emulator._set_coil(5, False)
            bank.wait_until(4.0, ignore)
        assert not any(virtual.emulator.contacts), "the fan too, at the end"


# All of them together.


def test_random_pulse_trains_break_no_limit():
    """Ten thousand of them in `make stress`."""
    ended = [play_random_train(seed).ended for seed in range(40)]
    assert {"played", "LimitError", "HeartbeatError"} <= set(ended)


def test_half_an_hour_of_a_schedule():
    """No drift, no growth, temperatures bounded; a hundred hours in `make stress`."""
    hours_of_a_schedule(0.5)
