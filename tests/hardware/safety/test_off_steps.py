"""The steps of `eldir rig off`, judged by the edges of an emulated board and by when its holder ended.

The board hangs on a pseudo-terminal, the program that holds it is a real one, and the records are files.
"""

from __future__ import annotations

import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from eldir.errors import InputError
from eldir_hardware.relay.registration import Board, installed_kinds
from eldir_hardware.rig.board_identity import identify
from eldir_hardware.safety import switch_off as switching
from eldir_hardware.safety.latch import BoardRecord, find_record, latch, latch_for_driving, read_stop, uptime
from eldir_hardware.safety.off_frames import off_frames
from eldir_hardware.safety.off_targets import OffTarget
from eldir_hardware.testing import close_contacts
from tests.hardware.emulated_rigs import emulated, wait
from tests.side_by_side import side_by_side

NOBODY = Path("/no/shared/folder")
ABSENT = "/dev/ttyUSB70"
QUESTION = b"\xff"
ONCE = len(off_frames("lcus", 4)) // 4
"""Frames that are sent before the port is one's own."""
PROVEN = "all 4 channels are open by the board's report"

HOLDER = """
import fcntl, os, signal, sys, threading
from pathlib import Path
from eldir_hardware.clock import WallClock
from eldir_hardware.emulator.a0 import EmulatedLcus
from eldir_hardware.safety.latch import latch
port, manner = sys.argv[1:]
board = EmulatedLcus(4, WallClock()) if port == "own" else None
if board:
    heard, obey = threading.Event(), board.obey
    board.obey = lambda request: (heard.set(), obey(request))[1]
    port = board.start()
handle = os.open(port, os.O_RDWR | os.O_NOCTTY)
fcntl.flock(handle, fcntl.LOCK_EX)

def end(*_):
    if board:
        heard.wait(5)
    else:
        sys.stdin.read()  # until the test lets it go on
    if "proves" in manner:
        latch(port, "ended", opened=True, shared=Path("/no/shared/folder"))
    if "hangs" not in manner:
        os._exit(0)

signal.signal(signal.SIGTERM, end)
print(port, flush=True)
while True:
    signal.pause()
"""


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch) -> Path:
    """The folder of the records, which is this test's own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


class Heard:
    """What a board obeyed: each request with its time. Lets its driver end after the first opening frames."""

    def __init__(self, board) -> None:
        self.driver: Driver | None = None
        self.requests: list[tuple[float, bytes]] = []
        obey = board.obey

        def hear(request: bytes) -> bytes:
            self.requests.append((time.monotonic(), request))
            if len(self.requests) >= ONCE and self.driver is not None:
                self.driver.release()
            return obey(request)

        board.obey = hear


@pytest.fixture
def board() -> Iterator:
    """Two contacts of four are closed."""
    with emulated("lcus") as board:
        close_contacts(board, (1, 3))
        yield board


class Driver:
    """A program that holds the lock of a port, and when it ended."""

    def __init__(self, program: subprocess.Popen, port: str) -> None:
        self.number, self.port, self.ended = program.pid, port, 0.0
        self._program = program
        self.record: BoardRecord | None = None
        """The board's record at the program's end."""
        self._watcher = threading.Thread(target=self._watch, args=(program,))
        self._watcher.start()

    def _watch(self, program: subprocess.Popen) -> None:
        program.wait()
        self.ended = time.monotonic()
        self.record = find_record(self.port, NOBODY)

    def release(self) -> None:
        """Let it end once it was asked to."""
        if not self._program.stdin.closed:
            self._program.stdin.close()

    def wait(self) -> None:
        self._watcher.join()


@contextmanager
def held(port: str, manner: str, heard: Heard | None = None) -> Iterator[Driver]:
    """`manner`: what it does when it is asked to end: proves, hangs, both, or ends. With `heard`, it ends
    when the board has obeyed the first opening frames."""
    command = [sys.executable, "-c", HOLDER, port, manner]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as program:
        driver = Driver(program, program.stdout.readline().strip())
        try:
            if heard is None:
                driver.release()
            else:
                heard.driver = driver
            yield driver
        finally:
            program.kill()
            driver.wait()


def off(port: str, *candidates: tuple[str, int | None], opened: float | None = None) -> switching.OffResult:
    """`opened`: when its record says that it was open, before."""
    known = None
    if opened is not None:
        known = BoardRecord(identify(port), port, "stopped", "2026", "lcus", 8, "bench", opened)
    return switching.switch_off(OffTarget(port, list(candidates), known), NOBODY)


def opened_at(board) -> float:
    """When the last contact moved, which must have opened."""
    assert not any(board.contacts) and not board.contact_events[-1].closed
    return max(edge.t for edge in board.contact_events)


# Frames, latch, the end of the other, proof: in this order.


def test_contacts_open_without_an_answer_of_the_board():
    """The frames wait for nothing. Without a report the stop is latched, and nothing is proven."""
    side_by_side(open_without_an_answer, [(kind,) for kind in installed_kinds()])


def open_without_an_answer(kind: str) -> None:
    with emulated(kind) as board:
        close_contacts(board, (1, 3))
        closed = len(board.contact_events)
        board.faults.silent = True
        outcome = off(board.port, (kind, 4))
        assert wait(lambda: not any(board.contacts))
        assert {(e.channel, e.closed) for e in board.contact_events[closed:]} == {(1, False), (3, False)}
        assert not outcome.proven and "did not answer" in outcome.report
        assert read_stop(board.port, NOBODY) == switching.OFF_REASON
        assert find_record(board.port, NOBODY).opened is None


def test_contacts_open_and_the_stop_is_latched_before_a_hanging_program_is_killed(board):
    latch_for_driving(board.port, "lcus", 4, "bench", shared=NOBODY)
    with held(board.port, "hangs") as driver:
        outcome = off(board.port, ("lcus", 4))
        driver.wait()
    assert opened_at(board) < driver.ended
    assert driver.record.stop == switching.OFF_REASON and driver.record.opened is None
    killed = f"stopped process {driver.number}; it did not end and was killed; "
    assert outcome.proven and outcome.report == killed + PROVEN
    assert find_record(board.port, NOBODY).opened is not None


def test_the_speed_of_a_port_is_set_unless_a_program_holds_it(board):
    """The frames would be noise to a board whose driver speaks at another speed."""

    def speed() -> int:
        return termios.tcgetattr(board.client_end)[4]

    speeds, obey = [], board.obey
    board.obey = lambda request: (speeds.append(speed()), obey(request))[1]
    mode = termios.tcgetattr(board.client_end)
    mode[4] = mode[5] = termios.B57600
    termios.tcsetattr(board.client_end, termios.TCSANOW, mode)
    with held(board.port, "ends", Heard(board)):
        assert off(board.port, ("lcus", 4)).proven
    assert speeds[0] == termios.B57600
    speeds.clear()
    termios.tcsetattr(board.client_end, termios.TCSANOW, mode)
    assert off(board.port, ("lcus", 4)).proven and speeds[0] == termios.B9600


def test_a_stop_that_cannot_be_latched_is_no_success(board, state):
    state.write_text("a file where the folder should be")
    outcome = off(board.port, ("lcus", 4))
    assert opened_at(board) and not outcome.proven
    assert outcome.report.startswith(f"{PROVEN}; the stop is not latched: ")


def test_what_is_not_proven_is_not_recorded_as_open(board):
    board.faults.deaf.add(3)
    outcome = off(board.port, ("lcus", 4))
    assert board.contacts == (False, False, True, False), "the other one opened"
    assert not outcome.proven and "channel 3" in outcome.report and "not latched" not in outcome.report
    found = find_record(board.port, NOBODY)
    assert found.stop == switching.OFF_REASON and found.opened is None


# A port that cannot be opened.


def test_a_board_that_is_not_connected_is_off_if_it_was_seen_off(tmp_path):
    """By whoever drove it last: where users keep their records apart, theirs prove nothing."""
    outcome = off(ABSENT, ("lcus", 4), opened=12.5)
    seen = "is not connected; all its contacts were open by the board's report when "
    assert outcome.proven is False and outcome.channels == 8
    assert outcome.report == f"{seen}you last stopped it, and runs of other users are recorded elsewhere"
    known = BoardRecord(identify(ABSENT), ABSENT, "stopped", "2026", "lcus", 8, "bench", 12.5)
    shared = switching.switch_off(OffTarget(ABSENT, [("lcus", 4)], known), tmp_path)
    assert shared.proven is True and shared.report == f"{seen}it was last driven"
    assert find_record(ABSENT, NOBODY) is None, "nothing was latched"


@pytest.mark.parametrize("known", [False, True])
def test_a_port_that_cannot_be_opened_proves_nothing(known):
    record = BoardRecord(identify(ABSENT), ABSENT, "stopped", "2026") if known else None
    outcome = switching.switch_off(OffTarget(ABSENT, [], record), NOBODY)
    assert (outcome.proven, outcome.report) == (False, "cannot be opened: No such file or directory")
    assert read_stop(ABSENT, NOBODY) == (switching.OFF_REASON if known else None)


def test_a_port_that_is_no_serial_port_proves_nothing():
    outcome = off("/dev/null", ("lcus", 4), opened=12.5)
    assert (outcome.proven, outcome.report) == (False, "cannot be opened: it is not a serial port")
    assert read_stop("/dev/null", NOBODY) == switching.OFF_REASON


# The proof.


def test_the_first_kind_that_answers_counts_and_the_first_problem_is_told(board):
    closed = len(board.contact_events)
    outcome = off(board.port, ("gd32", 2), ("lcus", 4))
    assert outcome.proven and outcome.report == PROVEN and outcome.channels == 4
    assert opened_at(board)
    assert not any(e.closed for e in board.contact_events[closed:]), "no frame of another kind closes"
    said = {}

    def ask_a_silent_board(*kinds: tuple[str, int]) -> None:
        with emulated("lcus") as silent:
            silent.faults.silent = True
            outcome = off(silent.port, *kinds)
            assert not outcome.proven
            said[kinds] = outcome.report.replace(silent.port, "its port")

    first, second = ("gd32", 2), ("lcus", 4)
    side_by_side(ask_a_silent_board, [(first,), (first, second), (second,)])
    assert said[first, second] == said[first,] != said[second,]


@pytest.mark.parametrize("candidates", [[("lcus", 4), ("gd32", 2)], [("gd32", None), ("lcus", 4)]])
def test_the_frames_of_all_that_it_may_be_come_before_the_first_question(board, candidates):
    heard = Heard(board)
    assert off(board.port, *candidates).proven
    asked = min(at for at, request in heard.requests if request == QUESTION)
    frames = b"".join(request for at, request in heard.requests if at < asked)
    for kind, channels in candidates:
        frame = off_frames(kind, channels)
        assert frames.count(frame[:4]) >= 2, "twice: what another kind's frame left may spoil the first"


def test_the_size_of_a_board_is_found_also_where_its_first_answer_is_lost():
    side_by_side(find_the_size, [(size, lost) for size in (1, 2, 4, 8) for lost in (0, 1)])


def find_the_size(size: int, lost: int) -> None:
    with emulated("lcus", size) as board:
        close_contacts(board, (1,))
        deliver, answers = board.send_answer, []

        def answer(data: bytes) -> None:
            answers.append(data)
            if len(answers) > lost:
                deliver(data)

        board.send_answer = answer
        outcome = off(board.port, ("lcus", None))
        assert opened_at(board) and outcome.proven and outcome.channels == size


@pytest.mark.parametrize(
    ("most", "counts"),
    [(8, [8, 4, 2, 1]), (14, [14, 8, 4, 2, 1]), (16, [16, 8, 4, 2, 1]), (32, [32, 16, 8, 4, 2, 1])],
)
def test_the_sizes_that_are_tried(most, counts):
    assert switching._sizes_to_try(most) == counts


def test_with_no_hint_every_kind_that_can_be_loaded_is_tried(monkeypatch):
    load = switching.get_board

    def get_board(kind: str) -> Board:
        if kind == "gd32":
            raise InputError("cannot be loaded")
        return load(kind)

    monkeypatch.setattr(switching, "get_board", get_board)
    found = switching._get_candidates(OffTarget(ABSENT))
    assert found == [(kind, None) for kind in installed_kinds() if kind != "gd32"]
    assert switching._get_candidates(OffTarget(ABSENT, [("lcus", 2)])) == [("lcus", 2)]


# What the guardian has proven.


def ended_well(manner: str, outcome: switching.OffResult) -> bool:
    """Whether it proved the board and ended by itself; on a busy computer it may be too slow for that."""
    return manner == "proves" and "was killed" not in outcome.report


@pytest.mark.parametrize("manner", ["proves", "ends", "proves and hangs"])
def test_a_guardian_that_has_proven_it_and_ended_is_looked_after_alone(board, manner):
    """Whoever was killed has proven nothing, nor does what was proven before the end was asked for count."""
    latch(board.port, "before", opened=True, shared=NOBODY)
    heard, before = Heard(board), find_record(board.port, NOBODY)
    with held(board.port, manner, heard) as driver:
        target = OffTarget(board.port, [("lcus", 4)], before)
        outcome = switching.switch_off(target, NOBODY)
        driver.wait()
    assert opened_at(board) and outcome.proven
    switched = [request for _, request in heard.requests if request != QUESTION]
    assert (len(switched) == ONCE) is ended_well(manner, outcome), switched
    assert PROVEN in outcome.report


def test_what_a_guardian_has_proven_and_is_not_seen_is_proven_again(board):
    """A contact closes after its proof."""
    obey = board.obey
    with held(board.port, "proves") as driver:

        def close_once(request: bytes) -> bytes:
            if (
                request == QUESTION
                and driver.ended
                and not board.contacts[1]
                and len(board.contact_events) < 5
            ):
                close_contacts(board, (2,))
            return obey(request)

        board.obey = close_once
        outcome = off(board.port, ("lcus", 4))
    assert [(e.channel, e.closed) for e in board.contact_events[4:]] == [(2, True), (2, False)]
    assert outcome.proven and opened_at(board)


@pytest.mark.parametrize("manner", ["proves", "ends"])
def test_a_port_that_went_away_is_off_where_its_guardian_has_proven_it_since(manner):
    """As that of a virtual rig goes with its program."""
    with held("own", manner) as driver:
        latch_for_driving(driver.port, "lcus", 4, "bench", shared=NOBODY)
        target = OffTarget(driver.port, [("lcus", 4)], at=identify(driver.port))
        outcome = switching.switch_off(target, NOBODY)
        driver.wait()
    assert outcome.proven is ended_well(manner, outcome), outcome.report
    if outcome.proven:
        gone = "all contacts were open by the board's report; then the port went away"
        assert outcome.report == f"stopped process {driver.number}; {gone}"
        assert driver.record.opened <= uptime() and outcome.channels is None


def test_a_record_that_cannot_be_read_proves_nothing(board, state):
    heard = Heard(board)
    with held(board.port, "proves") as driver:

        def damage() -> None:
            driver.wait()
            for file in (state / "eldir").glob("board-*.json"):
                file.write_text("{")

        watcher = threading.Thread(target=damage)
        watcher.start()
        outcome = off(board.port, ("lcus", 4))
        watcher.join()
    assert opened_at(board) and outcome.report.startswith(f"stopped process {driver.number}; {PROVEN}")
    assert heard.requests
