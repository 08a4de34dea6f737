"""A schedule played over messages, without ROS: the bank behind the sequencer, and who falls silent."""

import threading
import time

import pytest
from eldir_ros.conversions import runs
from eldir_ros.remote.heartbeats import Heartbeats
from eldir_ros.remote.remote_bank import BEAT, CUT, END, InterruptedRunError, RemoteBank

from eldir.errors import EldirError
from hardware.relay.errors import NotProvenOffError
from hardware.safety.stop_signals import StoppedError
from tests.ros.boards import Board


@pytest.fixture
def board():
    board = Board()
    yield board
    board.close()


def rest(board, seconds, seen=lambda report: None):
    board.bank.rest_until(time.monotonic() + seconds, seen)


def test_a_run_beats_reports_and_ends_proven_off(board):
    reports = []
    with board.bank.armed():
        board.bank.heat(time.monotonic() + 0.1, {1: 0.2})
        rest(board, 0.3, reports.append)
    assert board.told.count(BEAT) >= 3 and board.told[-1] == END
    assert any(r.closed == (True, False) for r in reports)
    assert reports[-1].closed == (False, False), "who watches sees the end"
    assert abs(reports[-1].t - time.monotonic()) < 1.0, "on the monotonic clock"


@pytest.mark.parametrize(
    ("end", "outcome"),
    [
        (lambda b: b.bank.interrupt(runs.CANCELLED, "cancelled"), runs.CANCELLED),
        (lambda b: setattr(b, "missing", ("camera is silent",)), runs.STOPPED),
    ],
)
def test_whatever_ends_a_run_in_mid_heating_opens_everything_at_once(board, end, outcome):
    ended = []

    def act():
        ended.append(time.monotonic())
        end(board)

    with pytest.raises(InterruptedRunError) as failure, board.bank.armed():
        board.bank.heat(time.monotonic(), {1: 5.0})
        threading.Timer(0.2, act).start()
        rest(board, 5.0)
    assert failure.value.outcome == outcome
    assert CUT in board.told and board.told[-1] == END and board.closed == ()
    assert time.monotonic() - ended[0] < 0.5


def test_an_emergency_stop_ends_a_run(board):
    threading.Timer(0.2, lambda: setattr(board, "stopped", "pressed")).start()
    with pytest.raises(StoppedError, match="pressed"), board.bank.armed():
        rest(board, 5.0)


def test_after_an_emergency_stop_the_observer_sees_the_contacts_open(board):
    """The board node reports once more that everything is off, when it is no longer armed."""
    reports = []

    def press():
        board.stopped, board.armed, board.closed = "pressed", False, ()

    with pytest.raises(StoppedError, match="pressed"), board.bank.armed():
        board.bank.heat(time.monotonic(), {1: 5.0})
        threading.Timer(0.3, press).start()
        rest(board, 5.0, reports.append)
    assert any(r.closed == (True, False) for r in reports)
    assert reports[-1].closed == (False, False)


def test_a_stop_that_nobody_has_proven_is_not_taken_for_off(board):
    board.welded = True
    threading.Timer(0.3, lambda: (setattr(board, "stopped", "pressed"), setattr(board, "dead", True))).start()
    with (
        pytest.raises(NotProvenOffError, match="pressed; the relay board did not report"),
        board.bank.armed(),
    ):
        board.bank.heat(time.monotonic(), {1: 5.0})
        rest(board, 5.0)


def test_a_board_that_is_disarmed_needs_no_later_report(board):
    """Relay board and sequencer get Ctrl-C together, and the relay board is the quicker one."""
    with board.bank.armed():
        board.bank.heat(time.monotonic(), {1: 5.0})
        rest(board, 0.1)
        board.armed, board.closed = False, ()
        time.sleep(0.1)
        board.dead = True


def test_a_board_that_reports_nothing_any_more_ends_a_run(board):
    board.welded = True
    begun = time.monotonic()
    with pytest.raises(EldirError), board.bank.armed():
        rest(board, 0.1)
        board.dead = True
        rest(board, 9.0)
    assert time.monotonic() - begun < 6.0


def test_a_contact_that_stays_closed_is_not_taken_for_open(board):
    board.welded = True
    with pytest.raises(NotProvenOffError, match="cut the heating supply"), board.bank.armed():
        board.bank.heat(time.monotonic(), {2: 1.0})
        rest(board, 0.1)


def test_nothing_starts_on_a_board_that_is_not_armed_or_reports_nothing(board):
    board.armed = False
    board.bank = RemoteBank(board, tuple, str)  # without the reports from before
    with pytest.raises(EldirError, match="not armed"):
        board.bank.arm()
    board.dead = True
    board.bank = RemoteBank(board, tuple, str)
    with pytest.raises(EldirError, match="found none"):
        board.bank.arm()
    assert board.told == []


def test_nodes_fall_silent_leave_or_are_absent():
    beats = Heartbeats(patience=0.5)
    beats.hear("camera", "active", 10.0)
    beats.hear("recorder", "inactive", 10.0)
    assert beats.silent(10.4) == () and beats.silent(10.6) == ("camera", "recorder")
    assert beats.missing(("camera",), 10.4) == ()
    wanted = ("camera", "recorder", "tracker")
    assert beats.missing(wanted, 10.4) == ("recorder is inactive", "tracker is absent")
    assert beats.missing(("camera",), 11.0) == ("camera is silent",)
    assert [beats.state_of(n, 10.4) for n in wanted] == ["active", "inactive", "absent"]
    assert beats.state_of("camera", 11.0) == "silent"
    beats.hear("camera", "finalized", 10.5)
    assert beats.silent(99.0) == ("recorder",), "who takes leave is not missed"
