"""A goal's course without ROS: refused, played, cancelled or stopped, with what it says on the way."""

import json
import threading
import time

import pytest
from eldir_msgs.action import RunSchedule
from eldir_msgs.msg import Run

from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import ActuationSchedule, Event
from eldir_ros.conversions import runs
from eldir_ros.conversions.schedules import read_schedule
from eldir_ros.remote.schedule_run import RunRequest, ScheduleRun
from tests.hardware.emulated_rigs import rig_values, wait
from tests.hardware.rigs_and_schedules import rig_with
from tests.ros2_nodes.remote_boards import Board

LIMITS, CUTOFF = {"min_off_s": 1.0}, {"max_on_s": 2.0}
RIG = rig_with(limits=LIMITS, cutoff=CUTOFF)
WITH_BROKEN_THERMOMETER = Rig.from_json(
    rig_values(
        "lcus",
        "/dev/none",
        limits=RIG.limits.model_dump(),
        cutoff=RIG.cutoff.model_dump(),
        thermometer={"kind": "w1", "path": "/sys/bus/w1/devices/28-none/temperature"},
    )
)
SCHEDULE = with_digests(
    ActuationSchedule(
        1.5,
        events=(Event(0.0, 0, "front", 1, True), Event(0.3, 0, "front", 1, False)),
        cycles=2,
        conditioning_cycles=0,
        settle_s=0.2,
        springs=(7,),
    ),
    RIG,
)
TEXT = json.dumps(SCHEDULE.to_json())
EDITED = TEXT.replace('"cycles": 2', '"cycles": 1')


class Notes:
    """Keeps what a listener is told."""

    def __init__(self):
        self.states, self.progress, self.messages = [], [], []

    def on_state(self, state, start_ns, message, room_c):
        self.room_c = room_c
        self.states.append((state, start_ns, message))

    def on_progress(self, progress):
        self.progress.append(progress)

    def on_message(self, text):
        self.messages.append(text)


@pytest.fixture
def board():
    board = Board()
    yield board
    board.close()


def play(board, text=TEXT, rig=RIG, lead=0.5, stopped="", accept="", client="tester", notes=None, room=None):
    notes = notes or Notes()
    request = RunRequest(lambda: read_schedule(text), client, lead, accept, lambda: runs.room_from(room))
    return ScheduleRun(board.bank, notes, time.time_ns).play(request, rig, stopped), notes


def when_it_heats(board, act):
    """Act as soon as a contact is closed, however busy the machine is."""

    def strike():
        assert wait(lambda: board.closed)
        act()

    thread = threading.Thread(target=strike)
    thread.start()
    return thread


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rig": None}, "not active"),
        ({"stopped": "pressed"}, "latched: pressed"),
        ({"client": ""}, "names no client"),
        ({"text": "{}"}, "not a schedule"),
        ({"rig": rig_with()}, "too little time to cool"),
        ({"text": EDITED}, "it was edited after eldir gait"),
        ({"text": json.dumps(SCHEDULE.to_json() | {"provenance": {}})}, "it lacks the digests"),
        (
            {"rig": rig_with(limits={"min_off_s": 1.2}, cutoff={"max_on_s": 2.0})},
            "the rig file has other values in limits",
        ),
        ({"room": 31}, "the air around the springs is outside of the rig file's tolerances"),
        ({"room": "warm"}, "room_c is no temperature of the air"),
        ({"room": True}, "found True"),
        ({"rig": WITH_BROKEN_THERMOMETER}, "cannot read the thermometer /sys/bus/w1/devices/28-none"),
        ({"text": "[" * 100_000}, "more than 64 levels"),
        ({"text": " " * (1 << 20) + TEXT}, "the schedule is too large"),
    ],
)
def test_what_cannot_be_played_is_refused_before_anything_is_said(board, change, message):
    result, notes = play(board, **change)
    assert result.outcome == runs.REFUSED and result.all_off and result.edges == ()
    assert (result.start_ns, result.duration, notes.states) == (0, 0.0, [])
    assert board.commands == [] and board.pulses == []
    assert message in result.message


def test_a_schedule_is_played_to_its_end(board):
    begun = time.time_ns()
    result, notes = play(board)
    assert (result.outcome, result.message, result.all_off) == (runs.FINISHED, "played to the end", True)
    assert begun + 0.4e9 < result.start_ns < time.time_ns() - SCHEDULE.duration * 1e9
    assert result.duration == pytest.approx(SCHEDULE.duration, abs=0.5)
    assert [s[0] for s in notes.states] == [Run.RUNNING, Run.FINISHED]
    assert {s[1] for s in notes.states} == {result.start_ns}
    assert len(board.pulses) == 2 and set(board.pulses[0]) == {1}
    # The fake board never opens by itself: it closes at the first pulse, and opens at the end.
    assert [(e.channel, e.closed) for e in result.edges] == [(1, True), (1, False)]
    assert notes.progress[0].edge is None and notes.progress[0].closed == ()
    phases = RunSchedule.Feedback
    wanted = {(phases.ARMING, 0), (phases.SETTLING, 0), (phases.COUNTING, 1), (phases.COUNTING, 2)}
    assert {(p.phase, p.cycle) for p in notes.progress} == wanted
    assert any(p.closed == (1,) and p.edge[1:] == (1, True) for p in notes.progress)


def test_an_edited_schedule_is_played_with_a_reason(board):
    result, notes = play(board, EDITED, accept="trial on the bench", room=21)
    assert result.outcome == runs.FINISHED and notes.room_c == 21.0
    assert "the air was measured before the run: 21 C" in notes.messages
    line = "the schedule was accepted although it was edited after eldir gait: trial on the bench"
    assert line in notes.messages


def test_a_board_that_is_slow_to_arm_delays_the_start(board, monkeypatch):
    """The start that is told is the one that is kept."""
    arm = board.bank.arm
    monkeypatch.setattr(board.bank, "arm", lambda: (time.sleep(1.0), arm()))
    begun = time.time_ns()
    result, notes = play(board)
    assert result.outcome == runs.FINISHED, result.message
    assert result.start_ns - begun > 1.4e9 and {s[1] for s in notes.states} == {result.start_ns}


@pytest.mark.parametrize(
    ("act", "outcome"),
    [
        (lambda b: b.bank.interrupt(runs.CANCELLED, "cancelled"), runs.CANCELLED),
        (lambda b: b.bank.interrupt(runs.PREEMPTED, "another schedule was sent"), runs.PREEMPTED),
        (lambda b: setattr(b, "stopped", "pressed"), runs.STOPPED),
        (lambda b: setattr(b, "missing", ("camera is silent",)), runs.STOPPED),
    ],
)
def test_a_run_that_is_ended_says_how(board, act, outcome):
    striking = when_it_heats(board, lambda: act(board))
    result, notes = play(board)
    striking.join()
    assert result.outcome == outcome and result.all_off
    assert result.duration < SCHEDULE.duration
    assert [s[0] for s in notes.states] == [Run.RUNNING, Run.ENDED]
    assert notes.states[-1][2] == notes.messages[-1] == result.message
    assert board.closed == ()


def test_a_contact_that_stays_closed_is_told(board):
    striking = when_it_heats(board, lambda: board.bank.interrupt(runs.CANCELLED, "cancelled"))
    board.welded = True
    result, _ = play(board)
    striking.join()
    assert not result.all_off and "cut the heating supply" in result.message
    board.bank = board.new_bank()  # of another goal
    refused, _ = play(board, stopped="the contact stays closed")
    assert (refused.outcome, refused.all_off) == (runs.REFUSED, False)


@pytest.mark.parametrize("change", [{"rig": None}, {"stopped": "pressed"}, {"text": "{}"}])
def test_a_board_that_reports_nothing_is_not_said_to_be_off(board, change):
    """Also where an older report is still waiting to be read, as for a goal that waited for another one."""
    assert wait(lambda: not board.bank._reports.empty())
    board.dead = True
    time.sleep(0.1)  # a report that is on its way
    result, _ = play(board, **change)
    assert (result.outcome, result.all_off) == (runs.REFUSED, False)


def test_a_client_that_has_gone_before_the_start_heats_nothing(board):
    board.missing = ("the client tester sends no heartbeats any more",)
    result, notes = play(board)
    assert (result.outcome, result.start_ns, notes.states) == (runs.REFUSED, 0, [])
    assert board.pulses == [] and "the client tester" in result.message


def test_a_fault_of_the_program_itself_ends_a_run_with_everything_off(board):
    class Broken(Notes):
        def on_progress(self, progress):
            if progress.closed == (1,):
                raise RecursionError("too deep")

    result, notes = play(board, notes=Broken())
    assert (result.outcome, result.message) == (runs.STOPPED, "RecursionError: too deep")
    assert result.all_off and board.closed == () and result.duration < SCHEDULE.duration
    assert notes.states[-1][0] == Run.ENDED


def test_an_empty_result_is_no_success():
    result = RunSchedule.Result()
    assert result.outcome == result.UNKNOWN and result.outcome != runs.FINISHED
    for name in ("FINISHED", "CANCELLED", "PREEMPTED", "STOPPED", "REFUSED"):
        assert getattr(result, name) == getattr(runs, name)
