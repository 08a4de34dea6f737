"""Real-time priority: the highest level that is permitted, for a thread and what it starts later."""

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from eldir_app import emergency_stop, main
from eldir_hardware.clock import VirtualClock, WallClock
from eldir_hardware.realtime import (
    COMMANDS,
    EMULATED_HARDWARE,
    GUARDIAN,
    VIRTUAL_BENCH,
    request_realtime_priority,
)
from eldir_hardware.rig.devices import get_emulator
from tests.hardware.emulated_rigs import wait


def policy(thread: int = 0) -> tuple[int, int]:
    """Scheduling policy and priority of a thread of this process, by default of the present one."""
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority


def policy_that_is_permitted(level: int) -> tuple[int, int]:
    """What a thread gets that asks the kernel itself."""

    def ask() -> tuple[int, int]:
        for priority in range(level, 0, -1):
            try:
                os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
                break
            except PermissionError:
                continue
        return policy()

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(ask).result()


@pytest.mark.parametrize("limit", range(5))
def test_the_highest_level_that_is_permitted(monkeypatch, limit):
    """Two levels above the limit of the user, one, at it; without any right nothing happens."""
    given = []

    def set_scheduler(thread: int, kind: int, param: os.sched_param) -> None:
        if param.sched_priority > limit:
            raise PermissionError
        given.append((thread, kind, param.sched_priority))

    monkeypatch.setattr(os, "sched_setscheduler", set_scheduler)
    request_realtime_priority(EMULATED_HARDWARE)
    assert given == [(0, os.SCHED_RR, limit)] * (limit > 0)


def test_hardware_comes_before_the_guardian_and_the_guardian_before_its_programs():
    assert EMULATED_HARDWARE > GUARDIAN > COMMANDS > VIRTUAL_BENCH > 0


def test_what_a_thread_starts_has_its_priority():
    before, found = policy(), []

    def start() -> None:
        request_realtime_priority(COMMANDS)
        child = threading.Thread(target=lambda: found.append(policy()))
        child.start()
        child.join()
        found.append(policy())

    thread = threading.Thread(target=start)
    thread.start()
    thread.join()
    assert found == [policy_that_is_permitted(COMMANDS)] * 2
    assert policy() == before, "the thread that started it is no faster"


def test_a_stop_has_the_priority_of_what_commands_heat(monkeypatch):
    """What draws pictures in `virtual_bench` has the lowest one."""
    monkeypatch.setattr(emergency_stop, "run_quickly", lambda arguments: policy())
    monkeypatch.setattr(sys, "path", list(sys.path))
    with ThreadPoolExecutor(1) as thread:
        found = thread.submit(main._run_emergency_stop, ["rig", "off"]).result()
    assert found == policy_that_is_permitted(COMMANDS)


@pytest.mark.parametrize("clock", [WallClock, VirtualClock])
def test_an_emulated_board_waits_for_no_program_on_the_wall_clock(clock):
    """In virtual time nothing is late."""
    board, others = get_emulator("lcus")(2, clock()), set(threading.enumerate())
    board.start()
    try:
        (thread,) = set(threading.enumerate()) - others
        expected = policy_that_is_permitted(EMULATED_HARDWARE) if clock is WallClock else policy()
        assert wait(lambda: policy(thread.native_id) == expected), policy(thread.native_id)
    finally:
        board.close()
