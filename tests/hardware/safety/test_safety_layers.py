"""Each layer of docs/safety.md alone: what it stops when all layers above it are gone.

Every test has a twin in it: the same fault with the layer taken out passes the ceiling or leaves the
contact closed, so that none can be lost unseen.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from eldir.built.heat import SpringState
from eldir.errors import EldirError
from eldir_hardware.guardian import pulse_controller
from eldir_hardware.guardian._interlock import Interlock
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.relay.errors import ContactError
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.player import Player
from eldir_hardware.safety import limits
from eldir_hardware.safety.limits import LimitError
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.guardian.random_pulse_trains import play_random_train
from tests.hardware.rigs_and_schedules import SCHEDULE, rig_with
from tests.hardware.run.hours_of_a_schedule import hours_of_a_schedule
from tests.hardware.virtual.piston_and_observer import Piston
from tests.raised import raises

TIMED = {"kind": "modbus", "retriggerable": True}


# Layer 0, a contact that is welded shut: test_cutoff_layer.py.


# Layer 1: pulses that the board times.


def test_a_timed_pulse_ends_when_host_and_guardian_are_gone():
    """The pulse controller stops after the pulse has begun: the board opens, an untimed one does not."""
    for kind, opens in ((TIMED, True), ({"kind": "lcus"}, False)):
        rig = rig_with(board=kind)
        with VirtualRig(rig, Piston()) as virtual:
            bank = PulseController(virtual.board, rig, virtual.clock)
            bank.arm()
            bank.heat(virtual.clock.now() + 0.3, {1: 5.0})
            bank.wait_until(virtual.clock.now() + 2.0)
            died = virtual.clock.now()
            virtual.clock.sleep_until(died + 5.0)
            assert (virtual.emulator.contacts[0] is False) is opens
            if opens:
                assert (
                    max(e.t for e in virtual.emulator.contact_events) - died
                    < pulse_controller.MAX_PULSE + 0.02
                )


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
        bank.wait_until(1.0)
        yield virtual, bank


def test_without_heartbeats_everything_goes_off():
    with heating() as (virtual, bank):
        assert virtual.emulator.contacts[0]
        with pytest.raises(pulse_controller.KeepaliveError):
            while virtual.clock.now() < 4.0:
                virtual.clock.sleep_until(min(bank.step(), virtual.clock.now() + 0.1))
        assert virtual.clock.now() < 1.0 + pulse_controller.PATIENCE + 0.15
        bank.stop("nobody")
        assert not any(virtual.emulator.contacts)


def test_who_stood_still_stops_although_a_heartbeat_lay_in_the_pipe():
    """Between two switchings too, so that no edge is late."""
    with heating() as (virtual, bank):
        virtual.clock.sleep_until(virtual.clock.now() + 0.8)
        bank.keep_alive()
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
                bank.wait_until(t - 0.3)
                bank.heat(t, lengths)
            bank.wait_until(pulses[-1][0] + 1.0)
        assert not any(virtual.emulator.contacts)


def test_the_current_is_checked_again_at_the_edge():
    """Announced 40 ms before another opens, which is as good as after it; but its contact is closed still."""
    rig = rig_with(supply={"max_total_current_a": 4})
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with raises(LimitError, "limit.supply"), bank.armed():
            bank.heat(1.0, {1: 2.0})
            bank.heat(2.96, {2: 1.0})
            bank.wait_until(5.0)
        assert not any(virtual.emulator.contacts) and {
            e.channel for e in virtual.emulator.contact_events
        } == {1}


def test_a_channel_that_nobody_opens_ends_the_run():
    """Whoever forgets it: what counts is when it was told to close, not for how long it was asked."""
    watch = Interlock(rig_with(supply={"current_limit_a": 1.5}), 0.0)
    watch.record_switching({2: True}, 0.0)
    watch.check(6.0 + limits.TIMER_STEP)
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
            watch.record_report(closed, float(t))
            watch.check(float(t))
    assert 5.0 < t < 30.0
    assert 60 < max(watch.temperatures) < 70, "a nominal spring: in the worst corner it is hotter"


def test_a_spring_that_is_too_hot_by_the_model_ends_the_run():
    rig = rig_with()
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with raises(LimitError, "limit.too-hot", match="by the model"), bank.armed():
            bank.heat(0.5, {1: 5.0})
            bank.wait_until(2.0)
            hot = bank._interlock._state
            bank._interlock._state = SpringState(hot.temperature + 70.0, hot.martensite)
            bank.wait_until(2.5)
        assert not any(virtual.emulator.contacts) and virtual.clock.now() < 2.6


def test_a_contact_that_closes_by_itself_ends_the_run():
    rig = rig_with()
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with pytest.raises(ContactError, match="channel 2 did not switch"), bank.armed():
            bank.wait_until(1.0)
            virtual.emulator.set_coil(2, True)
            bank.wait_until(3.0)
        assert not any(virtual.emulator.contacts) and virtual.clock.now() < 2.5


def test_a_pulse_whose_spring_is_still_hot_is_refused():
    """Each pulse is short and rested, but the springs have not cooled by the model."""
    rig = rig_with(limits={"min_off_s": 1.0, "duty": 1.0, "max_on_s": 4.0})
    watch = Interlock(rig, 0.0)
    now = 0.0
    with raises(LimitError, "limit.too-hot", match="by the model"):
        while now < 60:
            watch.check_pulses(now, {1: 4.0})
            for _ in range(40):
                now += 0.1
                watch.record_report((True, False, False, False), now)
            now += 1.1
            watch.record_report((False,) * 4, now)


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
            bank.wait_until(6.0)
        assert not left, "it was suspended"

    rig = rig_with()
    with VirtualRig(rig, Piston()) as virtual:
        with raises(EldirError, "guardian.stood-still", match=r"0\.8 s"):
            play(virtual)
        assert not any(virtual.emulator.contacts) and virtual.clock.now() < 4.0
    monkeypatch.setattr(PulseController, "_require_progress", lambda self, since, allowed=0.0: since)
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
        virtual.emulator.set_coil(3, True)
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
            bank.wait_until(2.0)
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
        with pytest.raises(EldirError, match="channel 5 did not switch"), bank.armed():
            bank.wait_until(2.0)
        assert virtual.emulator.contact_events == []
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with pytest.raises(EldirError, match="channel 5 did not switch"), bank.armed():
            bank.heat(1.0, {1: 5.0})
            bank.wait_until(2.0)
            assert virtual.emulator.contacts == (True, False, False, False, True)
            virtual.emulator.set_coil(5, False)
            bank.wait_until(4.0)
        assert not any(virtual.emulator.contacts), "the fan too, at the end"


# All of them together.


def test_random_pulse_trains_break_no_limit():
    """Ten thousand of them in `make stress`."""
    ended = [play_random_train(seed).ended for seed in range(25)]
    assert {"played", "LimitError", "KeepaliveError"} <= set(ended)


def test_twenty_minutes_of_a_schedule():
    """No drift, no growth, temperatures bounded; a hundred hours in `make stress`."""
    hours_of_a_schedule(0.35)
