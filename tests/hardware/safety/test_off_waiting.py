"""How long `eldir rig off` waits for a port and for the program that holds it, on a clock of the test.

What a board's contacts do meanwhile is in test_off_steps.py.
"""

import errno
import signal
from types import SimpleNamespace

import pytest

from eldir_hardware.relay.errors import PortError
from eldir_hardware.rig.port_holder import Holder
from eldir_hardware.safety import switch_off as stopping
from eldir_hardware.safety import switch_off as switching
from eldir_hardware.safety.switch_off import HolderStopper

PORT = "/dev/ttyUSB70"


class Time:
    def __init__(self) -> None:
        self.now, self.slept = 1000.0, 0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.slept += 1


@pytest.mark.parametrize(("held", "times"), [(False, 1), (True, 302)])
def test_a_port_that_its_last_program_still_holds_is_tried_for_a_while(monkeypatch, held, times):
    tried, time = [], Time()

    def driver(port: str, channels: int, clock: object) -> None:
        tried.append((port, channels))
        raise PortError("another program has it open")

    monkeypatch.setattr(switching, "get_board", lambda kind: SimpleNamespace(driver=driver))
    monkeypatch.setattr(switching, "find_holder", lambda port: "another" if held else None)
    monkeypatch.setattr(switching, "time", time)
    with pytest.raises(PortError):
        switching._open("lcus", PORT, 4)
    assert abs(len(tried) - times) <= 2 and set(tried) == {(PORT, 4)}
    assert time.now == pytest.approx(1001.5 if held else 1000, abs=0.011)


class Holders:
    """Who holds the port, and what was sent to it."""

    def __init__(self) -> None:
        self.time = Time()
        self.holder: Holder | None = Holder(7, 1000, False)
        self.sent: list[tuple[int, signal.Signals, float]] = []
        self.refuses: Exception | None = None
        self.hears = True
        self.leaves_at = 1e9
        self.frames = 0

    def find_holder(self, port: str) -> Holder | None:
        assert port == PORT
        return None if self.time.now >= self.leaves_at else self.holder

    def signal_holder(self, port: str, process: int, number: signal.Signals) -> bool:
        assert port == PORT
        self.sent.append((process, number, round(self.time.now - 1000, 2)))
        if self.refuses:
            raise self.refuses
        return self.hears

    def is_free(self) -> bool:
        return self.find_holder(PORT) is None

    def send(self) -> None:
        self.frames += 1


@pytest.fixture
def holders(monkeypatch):
    holders = Holders()
    monkeypatch.setattr(stopping, "time", holders.time)
    monkeypatch.setattr(stopping, "find_holder", holders.find_holder)
    monkeypatch.setattr(stopping, "signal_holder", holders.signal_holder)
    return holders


TERM, KILL = signal.SIGTERM, signal.SIGKILL


def ended(holders: Holders) -> HolderStopper:
    stopper = HolderStopper(PORT)
    stopper.request_end(may_kill=False)
    stopper.wait_until_port_is_free(holders, holders.send)
    return stopper


def test_a_port_that_nobody_holds(holders):
    holders.holder = None
    stopper = ended(holders)
    assert stopper.is_free and not stopper.has_killed and stopper.report == "" and holders.sent == []
    assert holders.frames == 0 and holders.time.slept == 0


def test_a_program_that_ends_when_it_is_asked(holders):
    holders.leaves_at = 1000.3
    stopper = ended(holders)
    assert stopper.is_free and not stopper.has_killed and stopper.report == "stopped process 7; "
    assert holders.sent == [(7, TERM, 0.0)]
    assert holders.frames == 0, "which would disturb its proof"
    assert stopper.holder == Holder(7, 1000, False)


def test_a_program_that_hangs_is_killed_when_it_had_its_time(holders):
    holders.leaves_at = 1000.9
    stopper = ended(holders)
    assert stopper.is_free and stopper.has_killed
    assert stopper.report == "stopped process 7; it did not end and was killed; "
    assert holders.sent[0] == (7, TERM, 0.0) and len(holders.sent) == 2
    assert holders.sent[1][:2] == (7, KILL) and 0.4 <= holders.sent[1][2] <= 0.42
    assert holders.frames == 1, "again, half a second after the first time"


def test_a_suspended_program_is_killed_at_once_but_not_before_the_latch(holders):
    holders.holder = Holder(7, 1000, True)
    stopper = HolderStopper(PORT)
    stopper.request_end(may_kill=False)
    assert holders.sent == [(7, TERM, 0.0)] and not stopper.has_killed
    stopper.request_end()
    stopper.request_end()
    assert [s[:2] for s in holders.sent] == [(7, TERM), (7, KILL)] and stopper.has_killed


def test_a_program_that_never_leaves(holders):
    stopper = ended(holders)
    assert not stopper.is_free and stopper.report.endswith("another program still holds the port; ")
    assert holders.time.now == pytest.approx(1001.5, abs=0.01)
    assert holders.frames == 2


def test_a_program_that_was_gone_when_it_was_to_be_killed(holders):
    stopper = HolderStopper(PORT)
    stopper.request_end()
    holders.time.now += 0.5
    holders.hears = False
    stopper.request_end()
    assert stopper.report == "stopped process 7; " and not stopper.has_killed, "what it has proven counts"


def test_the_next_program_that_takes_the_port_is_asked_too(holders):
    stopper = HolderStopper(PORT)
    stopper.request_end()
    holders.holder = Holder(8, 1000, False)
    stopper.request_end()
    assert holders.sent == [(7, TERM, 0.0), (8, TERM, 0.0)]
    assert stopper.report == "stopped process 7; stopped process 8; "


@pytest.mark.parametrize(("user", "of"), [(1000, " of user 1000"), (None, "")])
@pytest.mark.parametrize("how", ["refused", "unseen"])
def test_a_program_of_another_user_cannot_be_ended(holders, user, of, how):
    holders.holder = Holder(7, user, False)
    if how == "refused":
        holders.refuses, why = (
            PermissionError(errno.EPERM, "Operation not permitted"),
            "Operation not permitted",
        )
    else:
        holders.hears, why = False, "its open files cannot be read"
    stopper = HolderStopper(PORT)
    stopper.request_end()
    assert stopper.report == f"process 7{of} cannot be ended: {why}; "
    holders.time.now += 0.5
    stopper.request_end()
    assert len(holders.sent) == 1, "it is not tried again"


def test_a_program_that_ends_while_it_is_asked_is_no_failure(holders):
    holders.hears, holders.leaves_at = False, 1000.0
    stopper = HolderStopper(PORT)
    first = iter([Holder(7, 1000, False)])
    holders.find_holder = lambda port: next(first, None)
    stopping.find_holder = holders.find_holder
    stopper.request_end()
    assert stopper.report == "" and not stopper.has_killed
