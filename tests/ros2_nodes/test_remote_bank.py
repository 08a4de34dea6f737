"""A schedule played over messages, without ROS: the bank behind the sequencer, and who falls silent."""

import threading
import time

import pytest
from eldir_msgs.msg import HeatCommand

from eldir.errors import EldirError
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.safety.stop_signals import StoppedError
from eldir_ros.conversions import runs
from eldir_ros.remote.heartbeats import Heartbeats
from eldir_ros.remote.remote_bank import InterruptedRunError, ObeyedCommands
from tests.ros2_nodes.remote_boards import Board


@pytest.fixture
def board():
    board = Board()
    yield board
    board.close()


def rest(board, seconds, seen=lambda report: None):
    board.bank.wait_until(time.monotonic() + seconds, seen)


def test_a_run_beats_reports_and_ends_proven_off(board):
    reports = []
    with board.bank.armed():
        board.bank.heat(time.monotonic() + 0.1, {1: 0.2})
        rest(board, 0.3, reports.append)
    assert board.commands.count(HeatCommand.KEEPALIVE) >= 3 and board.commands[-1] == HeatCommand.END_OF_RUN
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
    assert (
        HeatCommand.ABORT in board.commands
        and board.commands[-1] == HeatCommand.END_OF_RUN
        and board.closed == ()
    )
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


@pytest.mark.parametrize("skew", [-5.0, 5.0])
def test_a_clock_that_is_wrong_changes_no_instant(board, skew):
    """The board's computer shows another time: pulses, reports and the proof of the end know durations."""
    reports = []
    board.skew = skew
    with board.bank.armed():
        begin = time.monotonic() + 0.2
        board.bank.heat(begin, {1: 0.2})
        rest(board, 0.3, reports.append)
    assert board.delays == pytest.approx([0.2], abs=0.1)
    assert all(abs(r.t - begin) < 2.0 for r in reports) and reports[-1].closed == (False, False)


@pytest.mark.parametrize("skew", [0.0, 5.0])
def test_only_a_report_after_the_command_proves_that_everything_is_off(board, skew):
    """With a clock that is ahead, an old report looks as if it were read after the command."""
    board.skew = skew
    with pytest.raises(NotProvenOffError, match="cut the heating supply"), board.bank.armed():
        rest(board, 0.1)
        board.deaf = True
    assert not any(board.closed), "which is what all reports said"


def test_the_age_of_a_report_tells_when_it_was_read(board):
    reports = []
    board.slow = 0.7
    with board.bank.armed():
        rest(board, 0.3, reports.append)
    assert all(-1.2 < r.t - time.monotonic() < -0.6 for r in reports[-3:])


def test_commands_that_were_obeyed_are_known_by_the_time_of_the_reading():
    obeyed = ObeyedCommands()
    assert obeyed.before(1.0) == ("", 0)
    for run, number, at in (("a", 1, 1.0), ("a", 2, 2.0), ("b", 1, 3.0)):
        obeyed.require_new(run, number)
        obeyed.add(run, number, at)
    assert [obeyed.before(t) for t in (0.5, 1.5, 2.0, 2.5, 9.0)] == [
        ("", 0), ("a", 1), ("a", 1), ("a", 2), ("b", 1)
    ]  # fmt: skip
    for number in (0, 1):
        with pytest.raises(ValueError, match="expected more than 1"):
            obeyed.require_new("b", number)


def test_nothing_starts_on_a_board_that_is_not_armed_or_reports_nothing(board):
    board.armed = False
    board.bank = board.new_bank()  # without the reports from before
    with pytest.raises(EldirError, match="not armed"):
        board.bank.arm()
    board.dead = True
    board.bank = board.new_bank()
    with pytest.raises(EldirError, match="found none"):
        board.bank.arm()
    assert board.commands == []


def test_a_run_waits_a_moment_for_a_node_that_is_late_and_no_longer(board):
    board.missing = ("camera is activating",)
    with pytest.raises(InterruptedRunError, match="camera is activating"):
        board.bank.arm()
    assert board.commands == []
    threading.Timer(0.3, lambda: setattr(board, "missing", ())).start()
    board.bank.arm()
    assert board.commands == [HeatCommand.KEEPALIVE]


def test_a_late_report_from_before_the_board_was_armed_refuses_no_run(board):
    board.armed = False
    board.bank = board.new_bank()
    threading.Timer(0.3, lambda: setattr(board, "armed", True)).start()
    board.bank.arm()
    assert board.commands == [HeatCommand.KEEPALIVE]


def test_nodes_fall_silent_leave_or_are_absent():
    beats = Heartbeats(timeout=0.5)
    beats.update("camera", "active", 10.0)
    beats.update("recorder", "inactive", 10.0)
    assert beats.silent(10.4) == () and beats.silent(10.6) == ("camera", "recorder")
    assert beats.missing(("camera",), 10.4) == ()
    wanted = ("camera", "recorder", "tracker")
    assert beats.missing(wanted, 10.4) == ("recorder is inactive", "tracker is absent")
    assert beats.missing(("camera",), 11.0) == ("camera is silent",)
    assert [beats.state_of(n, 10.4) for n in wanted] == ["active", "inactive", "absent"]
    assert beats.state_of("camera", 11.0) == "silent"
    beats.update("camera", "finalized", 10.5)
    assert beats.silent(99.0) == ("recorder",), "who takes leave is not missed"
