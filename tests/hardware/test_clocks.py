"""The wall's clock, the virtual one, and how long a commander is waited for."""

import threading
import time

import pytest

from eldir_hardware.clock import VirtualClock, WallClock
from eldir_hardware.guardian.bank import PATIENCE, Commander


def test_the_wall_clock_sleeps_in_short_naps(monkeypatch):
    """So that the handler of a signal runs soon."""
    naps: list[float] = []
    sleep = time.sleep
    monkeypatch.setattr(time, "sleep", lambda seconds: (naps.append(seconds), sleep(seconds)))
    clock = WallClock()
    begun = clock.now()
    clock.sleep_until(begun + 0.12)
    assert 0.12 <= clock.now() - begun < 0.5  # a busy machine included
    assert 2 <= len(naps) <= 4 and max(naps) <= 0.05
    clock.sleep_until(begun)
    assert len(naps) <= 4, "a time that has passed is not waited for"


def test_meeting_an_instant_waits_without_sleeping(monkeypatch):
    monkeypatch.setattr(time, "sleep", lambda seconds: pytest.fail("it slept"))
    clock = WallClock()
    until = clock.now() + 0.01
    clock.spin_until(until)
    assert until <= clock.now() < until + 0.2  # a busy machine included


def test_an_action_of_the_wall_clock():
    """In a thread that does not keep the program alive."""
    clock, ran = WallClock(), threading.Event()
    found: list[tuple[float, float, bool]] = []

    def action(t: float) -> None:
        found.append((t, clock.now(), threading.current_thread().daemon))
        ran.set()

    at = clock.now() + 0.05
    clock.call_at(at, action)
    assert ran.wait(5.0)
    t, now, daemon = found[0]
    assert t == at and now >= at - 1e-3 and daemon
    assert clock.follower() is clock


def test_actions_of_a_virtual_clock_run_in_order_of_time():
    clock = VirtualClock()
    ran: list[tuple[str, float, float]] = []

    def note(name: str):
        return lambda t: ran.append((name, t, clock.now()))

    clock.call_at(2.0, note("late"))
    clock.call_at(1.0, note("first"))
    clock.call_at(1.0, note("second"))
    clock.call_at(3.0, note("beyond"))
    clock.sleep_until(2.0)
    assert ran == [("first", 1.0, 1.0), ("second", 1.0, 1.0), ("late", 2.0, 2.0)]
    assert clock.now() == 2.0
    clock.sleep_until(1.0)
    assert clock.now() == 2.0, "never backwards"
    clock.call_at(0.5, note("past"))
    clock.sleep_until(2.0)
    assert ran[-1] == ("past", 2.0, 2.0)
    clock.spin_until(2.5)
    assert clock.now() == 2.5 and len(ran) == 4


def test_an_action_may_order_another_on_the_way():
    clock, ran = VirtualClock(), []
    clock.call_at(1.0, lambda t: clock.call_at(t + 0.5, ran.append))
    clock.sleep_until(2.0)
    assert ran == [1.5]


def test_time_waits_for_barriers_and_followers_do_not_move_it():
    clock, waited = VirtualClock(), []
    clock.add_barrier(lambda: waited.append(clock.now()))
    clock.sleep_until(1.0)
    assert waited == [0.0]
    follower = clock.follower()
    follower.sleep_until(5.0)
    follower.spin_until(5.0)
    assert clock.now() == follower.now() == 1.0
    assert follower.follower() is follower and follower.patience == clock.patience
    ran: list[float] = []
    follower.call_at(1.5, ran.append)
    clock.sleep_until(2.0)
    assert ran == [1.5]


# Who may heat.


@pytest.mark.parametrize(("silent", "lost"), [(0.0, None), (0.5, None), (1.0, None), (1.25, 1.25)])
def test_a_commander_is_lost_after_its_patience(silent, lost):
    commander = Commander(1.0)
    commander.record_command("a", 8.0)
    assert commander.silence_if_lost(8.0 + silent) == lost
    assert Commander()._patience == PATIENCE <= 0.6, "layer 2 of docs/safety.md"


def test_a_commander_that_was_never_heard_is_not_lost():
    commander = Commander()
    assert commander.name == "" and commander.silence_if_lost(1e9) is None
    assert commander.accepts("")
    commander.record_command("a", 1.0)
    assert commander.name == "a" and not commander.accepts("")
