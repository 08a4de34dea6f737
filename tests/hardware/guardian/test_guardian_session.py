"""What the guardian's process answers and does to each message; its controller only notes its orders."""

import gc
import io
import os
import select
import signal
import socket
import sys
import threading
import time
from contextlib import contextmanager, redirect_stderr
from types import SimpleNamespace

import pytest

from eldir.errors import EldirError
from eldir_hardware.guardian import process
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.measured_heat import CurrentFlowsError
from eldir_hardware.guardian.pulse_controller import HeartbeatError
from eldir_hardware.guardian.wire import Wire
from eldir_hardware.relay.errors import ContactError, NotProvenOffError
from eldir_hardware.rig.board_identity import BoardIdentity
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import (
    DIED,
    LatchedError,
    latch,
    latch_for_driving,
    record_of,
    require_unstopped,
    stop_of,
    unlatch,
)
from eldir_hardware.safety.spring_memory import SpringHeat, remember, remembered
from eldir_hardware.safety.stop_signals import StoppedError
from tests.hardware.rigs_and_schedules import RIG, rig_with
from tests.raised import raises

PORT = "/dev/ttyUSB70"
UNPROVEN = (
    "not proven that everything is off: channel 2 is closed; cut the heating supply now; "
    "it was stopped because: "
)
REAL = rig_with(kind="real", board={"port": PORT}, camera=None)
WARM = {1: SpringHeat((61.5, 70.25), (0.25, 0.0), ((12.0, 7.0),))}
DATA = RIG.to_json()


class Noting:
    """A controller that notes its orders; `fails` raises from an order."""

    proof = "proven by this test"
    rested_at = 1234.5

    def __init__(self) -> None:
        self.told: list[object] = []
        self.fails: dict[str, BaseException] = {}
        self.armed_once = False
        self.due: list[float] = []
        self.steps = 0
        self.stop_at_driving: str | None = None

    def _note(self, what: str, *more: object) -> None:
        self.told.append((what, *more) if more else what)
        if what in self.fails:
            raise self.fails[what]

    def step(self) -> float:
        self.steps += 1
        assert self.steps < 100, "it does not end"
        if "step" in self.fails:
            raise self.fails["step"]
        return self.due.pop(0) if self.due else time.monotonic() + 0.05

    def beat(self) -> None:
        self._note("beat")

    def check_limits(self) -> None:
        self.stop_at_driving = stop_of(PORT)
        self._note("agree")

    def arm(self) -> None:
        self._note("arm", stop_of(PORT), record_of(PORT).rig)
        if "arming" in self.fails:
            raise self.fails["arming"]

    def heat_left(self) -> dict[int, SpringHeat]:
        return WARM

    def heat(self, at: float, lengths: dict[int, float]) -> None:
        self._note("heat", at, lengths)
        if at < 0:
            raise LimitError("too early")

    def abort_pulses(self) -> None:
        self._note("cut")

    def disarm(self) -> None:
        self._note("disarm")

    def stop(self, why: str) -> None:
        self._note("stop", why)
        if "stopping" in self.fails:
            raise self.fails["stopping"]


@pytest.fixture(autouse=True)
def no_other_records(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture(autouse=True)
def signals():
    """Those of the tests, afterwards."""
    numbers = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
    before = [signal.getsignal(n) for n in numbers]
    yield
    signal.set_wakeup_fd(-1)
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.fixture
def wires():
    """Both ends of a wire: the program's and the guardian's."""
    ends = [Wire(end) for end in socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)]
    yield ends
    for end in ends:
        end.close()


def served(wires: list[Wire], *messages: dict, controller: Noting | None = None, end: bool = True) -> Noting:
    """Serve these messages, and the end of the session."""
    controller = controller or Noting()
    session = process._Session(wires[1], controller, RIG, PORT)
    for message in (*messages, *([{"do": "end"}] if end else [])):
        wires[0].send(**message)
    session.run()
    return controller


def told(wire: Wire) -> list[dict]:
    return wire.receive() or []


def test_the_end_of_a_session_is_no_stop(wires):
    controller = served(wires)
    assert controller.told == ["beat", "disarm"] and told(wires[0]) == []


def test_a_program_that_has_died(wires):
    wires[0].close()
    with raises(process.OrphanedError, "guardian.orphaned"):
        served(wires, end=False)


def test_every_message_counts_as_a_heartbeat_and_beats_are_answered(wires):
    controller = served(wires, {"do": "beat"}, {"do": "abort_pulses"})
    assert controller.told == ["beat", "cut", "disarm"]
    assert told(wires[0]) == [{"is": "alive"}]


def test_arming_asks_the_board_then_records_the_drive_then_arms(wires):
    controller = served(wires, {"do": "arm"})
    assert controller.stop_at_driving is None, "a board that does not fit leaves no record"
    assert controller.told == ["beat", "agree", ("arm", DIED, RIG.name), "disarm"]
    record = record_of(PORT)
    assert (record.kind, record.channels, record.port) == (RIG.board.kind, RIG.board.channels, PORT)
    assert told(wires[0]) == [{"is": "armed", "rested_at": 1234.5}]


def test_springs_count_as_hot_from_arming_until_everything_is_proven_off(wires):
    """Also where the arming itself fails: then they are as they were."""
    session = process._Session(wires[1], Noting(), REAL, PORT)
    session._obey({"do": "arm"})
    assert remembered(PORT) is None
    session._obey({"do": "disarm"})
    assert remembered(PORT).keys() == WARM.keys()
    session._obey({"do": "arm"})
    session._controller.armed_once = True
    wires[0].send(do="end")
    session.run()
    assert remembered(PORT).keys() == WARM.keys(), "also at an end without disarming"
    unlatch(PORT)
    refused = Noting()
    refused.fails["arming"] = EldirError("the board says no")
    with pytest.raises(EldirError, match="says no"):
        process._Session(wires[1], refused, REAL, PORT)._obey({"do": "arm"})
    assert remembered(PORT).keys() == WARM.keys() and record_of(PORT) is None


def test_springs_count_as_hot_where_it_cannot_be_written_how_hot_they_are(wires, monkeypatch):
    session = process._Session(wires[1], Noting(), REAL, PORT)
    session._obey({"do": "arm"})

    def full(*given: object) -> None:
        raise EldirError("cannot write")

    monkeypatch.setattr(process, "remember", full)
    session._obey({"do": "disarm"})
    assert told(wires[0])[-1] == {"is": "off"} and remembered(PORT) is None


@pytest.mark.parametrize(
    ("fails", "known"),
    [({}, True), ({"stopping": ContactError("channel 2 is closed")}, False),
     ({"step": NotProvenOffError("channel 2 does not follow")}, False)],
    ids=["proven off", "not proven", "not proven at once"],
)  # fmt: skip
def test_a_stop_tells_how_hot_the_springs_are_if_it_is_proven(wires, monkeypatch, fails, known):
    controller = Noting()
    controller.armed_once = True
    controller.fails = fails
    monkeypatch.setattr(sys.modules[__name__], "DATA", REAL.to_json())
    remember(PORT, None)
    guarded(wires, monkeypatch, controller, {"do": "stop", "why": "a key"})
    assert (remembered(PORT) is not None) is known


def test_nothing_arms_while_a_stop_is_latched(wires):
    latch(PORT, "too hot")
    controller = Noting()
    with pytest.raises(LatchedError, match="too hot"):
        served(wires, {"do": "arm"}, controller=controller)
    assert controller.told == ["beat"]


def test_pulses(wires):
    controller = served(
        wires, {"do": "heat", "at": 1.5, "for": {"1": 2.0, "4": 3.0}}, {"do": "heat", "at": -1.0, "for": {}}
    )
    assert controller.told[1:3] == [("heat", 1.5, {1: 2.0, 4: 3.0}), ("heat", -1.0, {})]
    assert told(wires[0]) == [{"is": "refused", "why": "too early", "code": "limit"}]


def test_disarming_says_that_it_has_begun_and_that_all_is_off(wires):
    latch_for_driving(PORT, "lcus", 4, "bench")
    controller = served(wires, {"do": "disarm"})
    assert controller.told == ["beat", "disarm", "disarm"]
    assert told(wires[0]) == [{"is": "opening"}, {"is": "off"}] and record_of(PORT) is None


def test_a_stop_of_the_program(wires):
    with pytest.raises(StoppedError, match="a key"):
        served(wires, {"do": "stop", "why": "a key"})


def test_reports_are_passed_on(wires):
    controller = served(wires)
    report = Report(1.0, (True,), (40.0,), 41.0, 0.01)
    controller.on_report(report)
    (message,) = told(wires[0])
    assert message["is"] == "report" and tuple(message["report"][:1]) == (1.0,)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_signals_end_the_session(wires, number):
    session = process._Session(wires[1], Noting(), RIG, PORT)
    os.kill(os.getpid(), number)
    with pytest.raises(StoppedError, match=f"stopped by {number.name}, such as `eldir rig off` sends"):
        session.run()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


@pytest.mark.parametrize("signalled", [False, True])
def test_an_error_behind_a_signal_is_its_consequence(wires, signalled):
    """`eldir rig off` opens the contacts, and then they do not follow."""
    controller = Noting()
    controller.fails["step"] = ContactError("relay channel 1 does not follow")
    session = process._Session(wires[1], controller, RIG, PORT)
    if signalled:
        os.kill(os.getpid(), signal.SIGTERM)
    with pytest.raises(StoppedError if signalled else ContactError):
        session.run()


def test_it_waits_until_the_controller_is_due_and_never_long(wires, monkeypatch):
    waited = []

    def select_now(sources: list, *rest: object):
        waited.append(rest[2])
        return (sources[:1] if len(waited) == 3 else []), [], []

    controller = Noting()
    now = time.monotonic()
    controller.due = [now - 5, now + 100.3, now + 1000]
    wires[0].send(do="end")
    session = process._Session(wires[1], controller, RIG, PORT)
    monkeypatch.setattr(process, "select", SimpleNamespace(select=select_now))
    monkeypatch.setattr(process, "time", SimpleNamespace(monotonic=lambda: now + 100))
    session.run()
    assert waited == [0.0, pytest.approx(0.3), 1.0]


@pytest.mark.parametrize("armed_before", [False, True])
@pytest.mark.parametrize("error", [ContactError("no fit"), NotProvenOffError("not proven")])
def test_arming_that_fails(wires, armed_before, error):
    """With the proof that nothing was heated no stop stays; without it, or after heating, it does."""
    controller = Noting()
    controller.armed_once = armed_before
    controller.fails["arming"] = error
    with pytest.raises(type(error)):
        served(wires, {"do": "arm"}, controller=controller)
    proven = not armed_before and isinstance(error, ContactError)
    assert controller.told[3:] == ([("stop", "no fit")] if proven else [])
    assert (record_of(PORT) is None) is proven


# The whole process, without its port.


BOARD = SimpleNamespace(handle=3)


@contextmanager
def unopened(monkeypatch, controller: Noting, ready=lambda: None):
    """`guard` gets this controller, and calls `ready` then; yields what it was made with."""
    made: dict[str, object] = {}

    @contextmanager
    def open_board(rig, clock, port):
        made["port"] = port
        yield BOARD

    @contextmanager
    def open_sensor(rig, clock, port):
        made["sensor_port"] = port
        yield SimpleNamespace(handle=4)

    def controlled(board, rig, clock, **more: object) -> Noting:
        made.update(more, board=board)
        ready()
        return controller

    with monkeypatch.context() as patch:
        patch.setattr(process, "open_board", open_board)
        patch.setattr(process, "open_sensor", open_sensor)
        patch.setattr(process, "PulseController", controlled)
        names = {3: PORT, 4: "/dev/sensor"}
        patch.setattr(
            process, "identify_open", lambda handle, given: BoardIdentity(names[handle], frozenset(), given)
        )
        patch.setattr(process, "_set_realtime_priority", lambda: made.update(hurried=True))
        yield made


def guarded(wires, monkeypatch, controller: Noting, *messages: dict) -> tuple[list[dict], dict, str]:
    """Serve a program that sends these messages; what it is told, with what it was made, and stderr."""

    def speak() -> None:
        for message in messages:
            wires[0].send(**message)

    wires[0].send(rig=DATA, port=PORT, named=PORT, sensor_port="/dev/sensor")
    said = io.StringIO()
    with unopened(monkeypatch, controller, speak) as made, redirect_stderr(said):
        process.guard(wires[1])
    return told(wires[0]), made, said.getvalue()


def test_a_session_from_its_first_message_to_its_end(wires, monkeypatch):
    answers, made, said = guarded(wires, monkeypatch, Noting(), {"do": "beat"}, {"do": "end"})
    devices = {"device": {"name": PORT, "marks": []}, "sensor": {"name": "/dev/sensor", "marks": []}}
    assert answers == [{"is": "ready", "process": os.getpid()} | devices, {"is": "alive"}] and said == ""
    may_close = made.pop("may_close")
    assert (may_close.func, may_close.args) == (require_unstopped, (BoardIdentity(PORT, frozenset()),))
    assert made.pop("before") is None, "its springs begin cold with a virtual rig"
    assert made == {
        "port": PORT,
        "sensor_port": "/dev/sensor",
        "board": BOARD,
        "sensor": SimpleNamespace(handle=4),
        "suspended": process._asleep,
        "hurried": True,
    }


def test_it_waits_for_the_first_message(wires, monkeypatch):
    """And ends without one."""
    threading.Timer(0.2, lambda: wires[0].send(rig=DATA, port=PORT, named=PORT)).start()
    with unopened(monkeypatch, Noting(), lambda: wires[0].send(do="end")) as made:
        process.guard(wires[1])
        assert made["sensor_port"] is None
    monkeypatch.setattr(process, "select", SimpleNamespace(select=lambda *_: ([], [], [])))
    assert process.guard(wires[1]) is None


@pytest.mark.parametrize("armed", [False, True])
def test_an_error_is_latched_if_anything_was_armed_and_told_with_its_proof(wires, monkeypatch, armed):
    controller = Noting()
    controller.armed_once = armed
    answers, _, said = guarded(wires, monkeypatch, controller, {"do": "stop", "why": "a key"})
    why = "a key; everything was switched off" + ("; proven by this test" if armed else "")
    stopped = {
        "is": "stopped",
        "why": why,
        "kind": "StoppedError",
        "code": "run.stopped",
        "proof": "proven by this test",
    }
    assert answers[1:] == [{"is": "opening"}, stopped]
    assert said == "" and controller.told[-1] == ("stop", "a key")
    if armed:
        assert record_of(PORT).stop == "a key" and record_of(PORT).opened is not None
    else:
        assert record_of(PORT) is None


def test_what_is_not_proven_bears_no_proof(wires, monkeypatch):
    controller = Noting()
    controller.armed_once = True
    controller.fails["stopping"] = ContactError("channel 2 is closed")
    answers, _, said = guarded(wires, monkeypatch, controller, {"do": "stop", "why": "a key"})
    why = f"{UNPROVEN}a key"
    assert answers[-1]["kind"] == "NotProvenOffError" and answers[-1]["proof"] is None and said == ""
    assert answers[-1]["why"] == why
    record = record_of(PORT)
    assert record.stop == why and record.opened is None


def test_an_error_that_is_not_proven_off_is_latched_at_once(wires, monkeypatch):
    controller = Noting()
    controller.fails["step"] = NotProvenOffError("channel 2 does not follow")
    answers, _, _ = guarded(wires, monkeypatch, controller)
    assert controller.told == [] and answers[-1]["why"] == "channel 2 does not follow"
    assert record_of(PORT).stop == "channel 2 does not follow" and record_of(PORT).opened is None


@pytest.mark.parametrize("first", [CurrentFlowsError("0.5 A flow"), ContactError("no answer")])
@pytest.mark.parametrize("armed", [False, True])
def test_current_that_flows_though_all_contacts_are_open(wires, monkeypatch, first, armed):
    """Nothing else matters then; it is latched even where nothing was armed."""
    controller = Noting()
    controller.armed_once = armed
    controller.fails["step"] = first
    controller.fails["stopping"] = CurrentFlowsError("0.5 A flow")
    answers, _, _ = guarded(wires, monkeypatch, controller)
    same = isinstance(first, CurrentFlowsError)
    why = "0.5 A flow" if same else "0.5 A flow; it was stopped because: no answer"
    assert answers[-1] == {
        "is": "stopped",
        "why": why,
        "kind": "CurrentFlowsError",
        "code": "heat.current-flows",
        "proof": None,
    }
    assert controller.told == [("stop", str(first))]
    if same or armed:
        assert record_of(PORT).stop == why and record_of(PORT).opened is None
    else:
        assert record_of(PORT) is None


def test_an_error_without_words_is_latched_by_its_name(wires, monkeypatch):
    controller = Noting()
    controller.armed_once = True
    controller.fails["step"] = ZeroDivisionError()
    with pytest.raises(ZeroDivisionError):
        guarded(wires, monkeypatch, controller)
    assert controller.told == [("stop", "ZeroDivisionError")] and record_of(PORT).stop == "ZeroDivisionError"


@pytest.mark.parametrize("proven", [True, False])
def test_where_the_program_has_died_the_terminal_is_told(wires, monkeypatch, proven):
    """Above all where the board does not confirm that everything is off."""
    controller = Noting()
    controller.armed_once = True
    if not proven:
        controller.fails["stopping"] = ContactError("channel 2 is closed")
    wires[0].send(rig=DATA, port=PORT, named=PORT)
    wires[0].close()
    said = io.StringIO()
    with unopened(monkeypatch, controller), redirect_stderr(said):
        process.guard(wires[1])
    died = "the program that heats has died"
    told = f"{died}; proven by this test" if proven else f"{UNPROVEN}{died}"
    assert said.getvalue() == f"eldir: {PORT}: {told}\n"


@pytest.mark.parametrize("proven", [True, False])
def test_where_the_program_hangs_the_terminal_is_told_what_is_not_proven(wires, monkeypatch, proven):
    controller = Noting()
    controller.armed_once = True
    controller.fails["step"] = HeartbeatError("nothing was heard for 0.7 s")
    if not proven:
        controller.fails["stopping"] = ContactError("channel 2 is closed")
    _, _, said = guarded(wires, monkeypatch, controller)
    assert said == ("" if proven else f"eldir: {PORT}: {UNPROVEN}nothing was heard for 0.7 s\n")


def test_before_it_heats_it_collects_garbage_and_asks_for_its_turn(monkeypatch):
    done = []
    monkeypatch.setattr(gc, "collect", lambda: done.append("collect"))
    monkeypatch.setattr(gc, "freeze", lambda: done.append("freeze"))

    def refused(*asked: object) -> None:
        done.append(asked)
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    process._set_realtime_priority()
    first = os.sched_param(1)
    assert done == ["collect", "freeze", (0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, first)]


def test_the_program_serves_the_socket_it_was_given(wires, monkeypatch):
    served: list[int] = []

    def guard(wire: Wire) -> None:
        served.append(wire.fileno())
        wire._end.detach()
        raise BrokenPipeError  # nobody reads what it prints

    monkeypatch.setattr(process, "guard", guard)
    monkeypatch.setattr(sys, "argv", ["eldir-guardian", "word", str(wires[1].fileno()), "port"])
    process.main()
    assert served == [wires[1].fileno()]
    assert select.select([wires[0]], [], [], 0) == ([], [], []), "still open"


def test_errors_of_the_session_are_errors_of_eldir():
    assert issubclass(process.OrphanedError, EldirError)
