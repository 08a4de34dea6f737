"""The steps of `eldir rig off` in their order, and what follows where one fails: no board, no process."""

import errno
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest

from eldir.errors import EldirError, InputError
from hardware.relay.errors import ContactError, PortError, SilentBoardError
from hardware.relay.off_frames import off_frames
from hardware.relay.registration import Board, kinds
from hardware.rig.board_identity import BoardIdentity
from hardware.rig.port_holder import Holder
from hardware.safety import holder_stopper as stopping
from hardware.safety import switch_off as switching
from hardware.safety.holder_stopper import HolderStopper
from hardware.safety.latch import BoardRecord
from hardware.safety.off_targets import Target
from hardware.safety.state_folder import StateError

PORT = "/dev/ttyUSB70"
SHARED = Path("/no/shared/folder")
LCUS = off_frames("lcus", 4)


def record(opened: float | None) -> BoardRecord:
    return BoardRecord(BoardIdentity(PORT, frozenset()), PORT, "stopped", "2026", "lcus", 8, "bench", opened)


class Steps:
    """What was done, in order; and what shall happen."""

    def __init__(self) -> None:
        self.told: list[object] = []
        self.fails: dict[str, Exception] = {}
        self.holder: object = None
        self.done = True
        self.killed = False
        self.latch_problem: str | None = None
        self.opened: float | None = None
        self.sizes: dict[tuple[str, int], list[Exception | None]] = {}
        """Of each kind and size, what happens when it is proven."""
        self.all_open = True
        self.slept: list[float] = []

    def note(self, what: str, *more: object) -> None:
        self.told.append((what, *more) if more else what)
        if what in self.fails:
            raise self.fails[what]


@pytest.fixture
def steps(monkeypatch):
    steps = Steps()

    class Stopper:
        text = "stopped process 7; "

        def __init__(self, port: str):
            self.holder, self.done, self.killed = steps.holder, steps.done, steps.killed

        def ask(self, may_kill: bool = True) -> None:
            steps.note("ask", may_kill)

        def wait(self, port, send) -> None:
            steps.note("wait")

    class Port:
        def __init__(self, port: str):
            steps.note("port")

        def send(self, frames: bytes, baud: int, held: bool) -> None:
            steps.note("send", frames, baud, held)

        def close(self) -> None:
            steps.note("close")

    class Opened:
        def __init__(self, kind: str, port: str, channels: int):
            self.name = (kind, channels)
            steps.note("open", kind, channels)

        def states(self, attempts: int = 2) -> None:
            steps.note("states", attempts)
            self.fail()

        def all_off(self) -> None:
            steps.note("all off")
            self.fail()

        def fail(self) -> None:
            if (left := steps.sizes.get(self.name)) and (error := left.pop(0)):
                raise error

        def reports_all_open(self) -> bool:
            steps.note("look")
            return steps.all_open

        def close(self) -> None:
            steps.note("board closed")

    class Clock:
        def sleep_until(self, t: float) -> None:
            steps.slept.append(t)

    def latch(port, why, *, opened=False, shared=None):
        assert (str(port), why, shared) == (PORT, "stopped by eldir rig off", SHARED)
        steps.note("latch", opened)
        return steps.latch_problem

    monkeypatch.setattr(switching, "HolderStopper", Stopper)
    monkeypatch.setattr(switching, "UnlockedPort", Port)
    monkeypatch.setattr(switching, "_open", Opened)
    monkeypatch.setattr(switching, "WallClock", Clock)
    monkeypatch.setattr(switching, "latch", latch)
    monkeypatch.setattr(switching, "time", SimpleNamespace(monotonic=lambda: 1000.0))
    monkeypatch.setattr(switching, "boottime", lambda: 50.0)
    monkeypatch.setattr(
        switching, "record_of", lambda port, shared: None if steps.opened is None else record(steps.opened)
    )
    return steps


def off(*candidates: tuple[str, int | None], before: float | None = None) -> switching.Outcome:
    known = None if before is None else record(before)
    return switching.switch_off(Target(PORT, list(candidates), known), SHARED)


def test_the_frames_first_then_the_latch_then_the_end_of_the_other_then_the_proof(steps):
    outcome = off(("lcus", 4))
    assert steps.told == [
        ("ask", False),
        "port",
        ("send", LCUS, 9600, False),
        ("latch", False),
        "wait",
        ("open", "lcus", 4),
        "all off",
        "board closed",
        "close",
        ("latch", True),
    ]
    assert outcome.proven is True and outcome.channels == 4 and steps.slept == []
    assert outcome.text == "stopped process 7; all 4 channels are open by the board's report"


def test_the_speed_of_a_held_port_is_left(steps):
    steps.holder = "another"
    off(("lcus", 4))
    assert steps.told[2] == ("send", LCUS, 9600, True)


def test_a_holder_that_cannot_be_asked_hinders_nothing(steps):
    steps.fails["ask"] = PermissionError()
    assert off(("lcus", 4)).proven


def test_the_frames_of_all_that_it_may_be_go_out_twice_and_are_waited_for_where_the_size_is_not_known(steps):
    off(("lcus", 4), ("gd32", 2))
    sent = [s for s in steps.told if s[0] == "send"]
    assert sent == [("send", 2 * LCUS, 9600, False), ("send", 2 * off_frames("gd32", 2), 115200, False)]
    assert steps.slept == []
    steps.told.clear()
    off(("lcus", 4), ("gd32", None))
    wire = 2 * 2 * len(LCUS) * 10 / 9600 + 2 * 2 * len(off_frames("gd32")) * 10 / 115200
    assert steps.slept == [pytest.approx(1000 + wire)]


def test_with_no_hint_every_kind_that_can_be_loaded_is_tried(steps, monkeypatch):
    load = switching.board_of

    def board_of(kind: str) -> Board:
        if kind == "gd32":
            raise InputError("cannot be loaded")
        return load(kind)

    monkeypatch.setattr(switching, "board_of", board_of)
    found = switching._candidates(Target(PORT))
    assert found == [(kind, None) for kind in kinds() if kind != "gd32"]
    assert switching._candidates(Target(PORT, [("lcus", 2)])) == [("lcus", 2)]


@pytest.mark.parametrize("number", [errno.ENOENT, errno.ENXIO])
def test_a_board_that_is_not_connected_is_off_if_it_was_seen_off(steps, number, tmp_path):
    """By whoever drove it last: where users keep their records apart, theirs prove nothing."""
    steps.fails["port"] = OSError(number, "gone")
    outcome = off(("lcus", 4), before=12.5)
    seen = "is not connected; all its contacts were open by the board's report when "
    assert outcome.proven is False and outcome.channels == 8
    assert outcome.text == f"{seen}you last stopped it, and runs of other users are recorded elsewhere"
    shared = switching.switch_off(Target(PORT, [("lcus", 4)], record(12.5)), tmp_path)
    assert shared.proven is True and shared.text == f"{seen}it was last driven"
    assert steps.told == 2 * [("ask", False), "port"]


@pytest.mark.parametrize("before", [None, "never"])
def test_a_port_that_cannot_be_opened_proves_nothing(steps, before):
    steps.fails["port"] = OSError(errno.ENOENT, "No such file or directory")
    known = None if before is None else record(None)
    outcome = switching.switch_off(Target(PORT, [], known), SHARED)
    assert (outcome.proven, outcome.text) == (False, "cannot be opened: No such file or directory")
    assert (("latch", False) in steps.told) is (known is not None)


def test_a_port_that_may_not_be_opened_proves_nothing(steps):
    steps.fails["port"] = PermissionError(errno.EACCES, "Permission denied")
    outcome = off(("lcus", 4), before=12.5)
    assert (outcome.proven, outcome.text) == (False, "cannot be opened: Permission denied")
    assert steps.told[-1] == ("latch", False)


def test_a_holder_that_does_not_leave_makes_the_proof_impossible(steps):
    steps.done = False
    outcome = off(("lcus", 4))
    assert outcome.proven is False
    assert outcome.text == "stopped process 7; its report cannot be asked for"
    assert steps.told[-2:] == ["wait", "close"], "the frames are out, and the stop is latched"


def test_an_error_is_told_and_the_port_closed(steps):
    steps.fails["wait"] = EldirError("something")
    outcome = off(("lcus", 4))
    assert (outcome.proven, outcome.text) == (False, "something") and steps.told[-1] == "close"


def test_a_stop_that_cannot_be_latched_is_no_success(steps):
    steps.latch_problem = "the disk is full"
    outcome = off(("lcus", 4))
    assert outcome.proven is False
    assert outcome.text.endswith("by the board's report; the stop is not latched: the disk is full")


def test_what_is_not_proven_is_not_recorded_as_open(steps):
    steps.sizes["lcus", 4] = [ContactError("channel 2 is closed")]
    steps.latch_problem = "the disk is full"
    outcome = off(("lcus", 4))
    assert outcome.proven is False and ("latch", True) not in steps.told
    assert outcome.text == "stopped process 7; channel 2 is closed; the stop is not latched: the disk is full"


# The proof.


def test_the_first_kind_that_answers_counts_and_the_first_problem_is_told(steps):
    steps.sizes["lcus", 4] = [SilentBoardError("lcus is silent")]
    outcome = off(("lcus", 4), ("gd32", 2))
    assert outcome.proven and outcome.channels == 2
    steps.sizes |= {
        ("lcus", 4): [SilentBoardError("lcus is silent")],
        ("gd32", 2): [SilentBoardError("gd32 is silent")],
    }
    outcome = off(("lcus", 4), ("gd32", 2))
    assert outcome.text == "stopped process 7; lcus is silent"


@pytest.mark.parametrize(
    ("most", "counts"),
    [(8, [8, 4, 2, 1]), (14, [14, 8, 4, 2, 1]), (16, [16, 8, 4, 2, 1]), (32, [32, 16, 8, 4, 2, 1])],
)
def test_the_sizes_that_are_tried(most, counts):
    assert switching._counts(most) == counts


def test_a_board_of_unknown_size_is_asked_first_and_then_proven(steps):
    steps.sizes["lcus", 8] = [SilentBoardError("too short")] * 3
    outcome = off(("lcus", None))
    assert outcome.channels == 4
    assert [s for s in steps.told if s != "board closed"][5:] == [
        ("open", "lcus", 8), ("states", 1), ("open", "lcus", 4), ("states", 1), "all off",
        ("open", "lcus", 8), ("states", 1), "close", ("latch", True),
    ]  # fmt: skip
    assert steps.told.count("board closed") == 3


def test_a_larger_size_that_answers_at_the_second_time_counts(steps):
    late = SilentBoardError("too late")
    steps.sizes |= {("lcus", 8): [late, late, None, None], ("lcus", 4): [late, None, None, None]}
    outcome = off(("lcus", None))
    assert outcome.channels == 4, "the largest that is proven without a gap"
    steps.sizes = {("lcus", 8): [late, None, None], ("lcus", 4): [late, None, None]}
    assert off(("lcus", None)).channels == 8
    steps.sizes = {("lcus", 8): [late, None, None], ("lcus", 4): [late, late]}
    assert off(("lcus", None)).channels == 2
    assert "look" not in steps.told, "nobody has proven that size"


@pytest.mark.parametrize(
    ("before", "opened", "killed", "looked"),
    [
        (None, 50.0, False, True),
        (12.5, 50.0, False, True),
        (12.5, 12.5, False, False),
        (None, 49.9, False, False),
        (None, 50.1, False, False),
        (None, None, False, False),
        (12.5, None, False, False),
        (50.0, 50.0, False, False),
        (None, 50.0, True, False),
    ],
)
def test_a_guardian_that_has_proven_it_since_is_looked_after_alone(steps, before, opened, killed, looked):
    """Since it was asked to end, and it was not killed."""
    steps.opened, steps.killed = opened, killed
    assert off(("lcus", 4), before=before).proven
    assert ("look" in steps.told) is looked and ("all off" in steps.told) is not looked


@pytest.mark.parametrize(
    ("opened", "killed", "there", "proven"),
    [
        (50.0, False, False, True),
        (50.0, True, False, False),
        (50.0, False, True, False),
        (49.9, False, False, False),
        (None, False, False, False),
    ],
)
def test_a_port_that_went_away_is_off_where_its_guardian_has_proven_it_since(
    steps, monkeypatch, opened, killed, there, proven
):
    """As that of a virtual rig goes with its program; not where the board is there and does not answer."""
    steps.opened, steps.killed = opened, killed
    lost = PortError("was lost", remedy="cut it")
    steps.fails = {"look": lost, "all off": lost}
    monkeypatch.setattr(switching, "_is_there", lambda target: there)
    outcome = off(("lcus", 4))
    assert outcome.proven is proven
    gone = "stopped process 7; all contacts were open by the board's report; then the port went away"
    assert outcome.text == gone if proven else "was lost" in outcome.text
    assert (("latch", True) in steps.told) is proven
    assert outcome.channels is None


def test_what_a_guardian_has_proven_and_is_not_seen_is_proven_again(steps):
    steps.opened, steps.all_open = 50.0, False
    assert off(("lcus", 4)).proven
    assert steps.told[5:9] == [("open", "lcus", 4), "look", "all off", "board closed"]


def test_a_record_that_cannot_be_read_proves_nothing(steps, monkeypatch):
    def unreadable(port, shared):
        raise StateError("cannot be trusted")

    monkeypatch.setattr(switching, "record_of", unreadable)
    assert off(("lcus", 4)).proven and "all off" in steps.told


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

    monkeypatch.setattr(switching, "board_of", lambda kind: SimpleNamespace(driver=driver))
    monkeypatch.setattr(switching, "holder_of", lambda port: "another" if held else None)
    monkeypatch.setattr(switching, "time", time)
    with pytest.raises(PortError):
        switching._open("lcus", PORT, 4)
    assert abs(len(tried) - times) <= 2 and set(tried) == {(PORT, 4)}
    assert time.now == pytest.approx(1001.5 if held else 1000, abs=0.011)


# The end of the program that holds the port.


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

    def holder_of(self, port: str) -> Holder | None:
        assert port == PORT
        return None if self.time.now >= self.leaves_at else self.holder

    def signal_holder(self, port: str, process: int, number: signal.Signals) -> bool:
        assert port == PORT
        self.sent.append((process, number, round(self.time.now - 1000, 2)))
        if self.refuses:
            raise self.refuses
        return self.hears

    def is_free(self) -> bool:
        return self.holder_of(PORT) is None

    def send(self) -> None:
        self.frames += 1


@pytest.fixture
def holders(monkeypatch):
    holders = Holders()
    monkeypatch.setattr(stopping, "time", holders.time)
    monkeypatch.setattr(stopping, "holder_of", holders.holder_of)
    monkeypatch.setattr(stopping, "signal_holder", holders.signal_holder)
    return holders


TERM, KILL = signal.SIGTERM, signal.SIGKILL


def ended(holders: Holders) -> HolderStopper:
    stopper = HolderStopper(PORT)
    stopper.ask(may_kill=False)
    stopper.wait(holders, holders.send)
    return stopper


def test_a_port_that_nobody_holds(holders):
    holders.holder = None
    stopper = ended(holders)
    assert stopper.done and not stopper.killed and stopper.text == "" and holders.sent == []
    assert holders.frames == 0 and holders.time.slept == 0


def test_a_program_that_ends_when_it_is_asked(holders):
    holders.leaves_at = 1000.3
    stopper = ended(holders)
    assert stopper.done and not stopper.killed and stopper.text == "stopped process 7; "
    assert holders.sent == [(7, TERM, 0.0)]
    assert holders.frames == 0, "which would disturb its proof"
    assert stopper.holder == Holder(7, 1000, False)


def test_a_program_that_hangs_is_killed_when_it_had_its_time(holders):
    holders.leaves_at = 1000.9
    stopper = ended(holders)
    assert stopper.done and stopper.killed
    assert stopper.text == "stopped process 7; it did not end by itself and was killed; "
    assert holders.sent[0] == (7, TERM, 0.0) and len(holders.sent) == 2
    assert holders.sent[1][:2] == (7, KILL) and 0.4 <= holders.sent[1][2] <= 0.42
    assert holders.frames == 1, "again, half a second after the first time"


def test_a_suspended_program_is_killed_at_once_but_not_before_the_latch(holders):
    holders.holder = Holder(7, 1000, True)
    stopper = HolderStopper(PORT)
    stopper.ask(may_kill=False)
    assert holders.sent == [(7, TERM, 0.0)] and not stopper.killed
    stopper.ask()
    stopper.ask()
    assert [s[:2] for s in holders.sent] == [(7, TERM), (7, KILL)] and stopper.killed


def test_a_program_that_never_leaves(holders):
    stopper = ended(holders)
    assert not stopper.done and stopper.text.endswith("another program holds the port; ")
    assert holders.time.now == pytest.approx(1001.5, abs=0.01)
    assert holders.frames == 2


def test_a_program_that_was_gone_when_it_was_to_be_killed(holders):
    stopper = HolderStopper(PORT)
    stopper.ask()
    holders.time.now += 0.5
    holders.hears = False
    stopper.ask()
    assert stopper.text == "stopped process 7; "


def test_the_next_program_that_takes_the_port_is_asked_too(holders):
    stopper = HolderStopper(PORT)
    stopper.ask()
    holders.holder = Holder(8, 1000, False)
    stopper.ask()
    assert holders.sent == [(7, TERM, 0.0), (8, TERM, 0.0)]
    assert stopper.text == "stopped process 7; stopped process 8; "


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
    stopper.ask()
    assert stopper.text == f"process 7{of} cannot be ended: {why}; "
    holders.time.now += 0.5
    stopper.ask()
    assert len(holders.sent) == 1, "it is not tried again"


def test_a_program_that_ends_while_it_is_asked_is_no_failure(holders):
    holders.hears, holders.leaves_at = False, 1000.0
    stopper = HolderStopper(PORT)
    first = iter([Holder(7, 1000, False)])
    holders.holder_of = lambda port: next(first, None)
    stopping.holder_of = holders.holder_of
    stopper.ask()
    assert stopper.text == "" and not stopper.killed
