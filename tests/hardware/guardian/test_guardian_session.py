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
from eldir_hardware.guardian import _process as process
from eldir_hardware.guardian._connection import GuardianConnection
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.measured_heat import CurrentFlowsError
from eldir_hardware.guardian.pulse_controller import KeepaliveError
from eldir_hardware.relay.errors import ContactError, NotProvenOffError
from eldir_hardware.rig.board_identity import BoardIdentity
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import (
    GUARDIAN_DIED,
    LatchedError,
    find_record,
    latch,
    latch_for_driving,
    read_stop,
    require_not_stopped,
    unlatch,
)
from eldir_hardware.safety.spring_memory import SpringHeat, load_springs, save_springs
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
    ready_at = 1234.5

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

    def keep_alive(self) -> None:
        self._note("beat")

    def check_limits(self) -> None:
        self.stop_at_driving = read_stop(PORT)
        self._note("agree")

    def arm(self) -> None:
        self._note("arm", read_stop(PORT), find_record(PORT).rig)
        if "arming" in self.fails:
            raise self.fails["arming"]

    def export_springs(self) -> dict[int, SpringHeat]:
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
    ends = [GuardianConnection(end) for end in socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)]
    yield ends
    for end in ends:
        end.close()


def served(
    wires: list[GuardianConnection], *messages: dict, controller: Noting | None = None, end: bool = True
) -> Noting:
    """Serve these messages, and the end of the session."""
    controller = controller or Noting()
    session = process._Session(wires[1], controller, RIG, PORT)
    for message in (*messages, *([{"command": "end_session"}] if end else [])):
        wires[0].send(**message)
    session.run()
    return controller


def told(wire: GuardianConnection) -> list[dict]:
    return wire.receive() or []


def test_the_end_of_a_session_is_no_stop(wires):
    controller = served(wires)
    assert controller.told == ["beat", "disarm"] and told(wires[0]) == []


def test_a_program_that_has_died(wires):
    wires[0].close()
    with raises(process.ParentDiedError, "guardian.orphaned"):
        served(wires, end=False)


def test_every_message_counts_as_a_heartbeat_and_beats_are_answered(wires):
    controller = served(wires, {"command": "keepalive"}, {"command": "abort_pulses"})
    assert controller.told == ["beat", "cut", "disarm"]
    assert told(wires[0]) == [{"event": "acknowledged"}]


def test_arming_asks_the_board_then_records_the_drive_then_arms(wires):
    controller = served(wires, {"command": "arm"})
    assert controller.stop_at_driving is None, "a board that does not fit leaves no record"
    assert controller.told == ["beat", "agree", ("arm", GUARDIAN_DIED, RIG.name), "disarm"]
    record = find_record(PORT)
    assert (record.kind, record.channels, record.port) == (RIG.board.kind, RIG.board.channels, PORT)
    assert told(wires[0]) == [{"event": "armed", "ready_at": 1234.5}]


def test_springs_count_as_hot_from_arming_until_everything_is_proven_off(wires):
    """Also where the arming itself fails: then they are as they were."""
    session = process._Session(wires[1], Noting(), REAL, PORT)
    session._obey({"command": "arm"})
    assert load_springs(PORT) is None
    session._obey({"command": "disarm"})
    assert load_springs(PORT).keys() == WARM.keys()
    session._obey({"command": "arm"})
    session._controller.armed_once = True
    wires[0].send(command="end_session")
    session.run()
    assert load_springs(PORT).keys() == WARM.keys(), "also at an end without disarming"
    unlatch(PORT)
    refused = Noting()
    refused.fails["arming"] = EldirError("the board says no")
    with pytest.raises(EldirError, match="says no"):
        process._Session(wires[1], refused, REAL, PORT)._obey({"command": "arm"})
    assert load_springs(PORT).keys() == WARM.keys() and find_record(PORT) is None


def test_springs_count_as_hot_where_it_cannot_be_written_how_hot_they_are(wires, monkeypatch):
    session = process._Session(wires[1], Noting(), REAL, PORT)
    session._obey({"command": "arm"})

    def full(*given: object) -> None:
        raise EldirError("cannot write")

    monkeypatch.setattr(process, "save_springs", full)
    session._obey({"command": "disarm"})
    assert told(wires[0])[-1] == {"event": "off"} and load_springs(PORT) is None


@pytest.mark.parametrize(
    ("fails", "known"),
    [({}, True), ({"stopping": ContactError("channel 2 is closed")}, False),
     ({"step": NotProvenOffError("channel 2 did not switch")}, False)],
    ids=["proven off", "not proven", "not proven at once"],
)  # fmt: skip
def test_a_stop_tells_how_hot_the_springs_are_if_it_is_proven(wires, monkeypatch, fails, known):
    controller = Noting()
    controller.armed_once = True
    controller.fails = fails
    monkeypatch.setattr(sys.modules[__name__], "DATA", REAL.to_json())
    save_springs(PORT, None)
    guarded(wires, monkeypatch, controller, {"command": "stop", "reason": "a key"})
    assert (load_springs(PORT) is not None) is known


def test_nothing_arms_while_a_stop_is_latched(wires):
    latch(PORT, "too hot")
    controller = Noting()
    with pytest.raises(LatchedError, match="too hot"):
        served(wires, {"command": "arm"}, controller=controller)
    assert controller.told == ["beat"]


def test_pulses(wires):
    controller = served(
        wires,
        {"command": "heat", "at": 1.5, "durations": {"1": 2.0, "4": 3.0}},
        {"command": "heat", "at": -1.0, "durations": {}},
    )
    assert controller.told[1:3] == [("heat", 1.5, {1: 2.0, 4: 3.0}), ("heat", -1.0, {})]
    assert told(wires[0]) == [{"event": "refused", "reason": "too early", "code": "limit"}]


def test_disarming_says_that_it_has_begun_and_that_all_is_off(wires):
    latch_for_driving(PORT, "lcus", 4, "bench")
    controller = served(wires, {"command": "disarm"})
    assert controller.told == ["beat", "disarm", "disarm"]
    assert told(wires[0]) == [{"event": "opening"}, {"event": "off"}] and find_record(PORT) is None


def test_a_stop_of_the_program(wires):
    with pytest.raises(StoppedError, match="a key"):
        served(wires, {"command": "stop", "reason": "a key"})


def test_reports_are_passed_on(wires):
    controller = served(wires)
    report = Report(1.0, (True,), (40.0,), 41.0, 0.01)
    controller.on_report(report)
    (message,) = told(wires[0])
    assert message["event"] == "report" and tuple(message["report"][:1]) == (1.0,)


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
    controller.fails["step"] = ContactError("relay channel 1 did not switch")
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
    wires[0].send(command="end_session")
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
        served(wires, {"command": "arm"}, controller=controller)
    proven = not armed_before and isinstance(error, ContactError)
    assert controller.told[3:] == ([("stop", "no fit")] if proven else [])
    assert (find_record(PORT) is None) is proven


# The whole process, without its port.


BOARD = SimpleNamespace(file_descriptor=3)


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
        yield SimpleNamespace(file_descriptor=4)

    def controlled(board, rig, clock, sensor, springs, host) -> Noting:
        made.update(board=board, sensor=sensor, springs=springs, host=host)
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

    wires[0].send(rig=DATA, port=PORT, given_name=PORT, sensor_port="/dev/sensor")
    said = io.StringIO()
    with unopened(monkeypatch, controller, speak) as made, redirect_stderr(said):
        process.serve_parent(wires[1])
    return told(wires[0]), made, said.getvalue()


def test_a_session_from_its_first_message_to_its_end(wires, monkeypatch):
    answers, made, said = guarded(
        wires, monkeypatch, Noting(), {"command": "keepalive"}, {"command": "end_session"}
    )
    devices = {"device": {"name": PORT, "marks": []}, "sensor": {"name": "/dev/sensor", "marks": []}}
    assert (
        answers == [{"event": "ready", "process": os.getpid()} | devices, {"event": "acknowledged"}]
        and said == ""
    )
    host = made.pop("host")
    assert host.suspended_time is process._suspended_time
    before_closing = host.before_closing
    assert before_closing.func is require_not_stopped
    assert before_closing.args == (BoardIdentity(PORT, frozenset()),)
    assert made.pop("springs") is None, "its springs begin cold with a virtual rig"
    assert made == {
        "port": PORT,
        "sensor_port": "/dev/sensor",
        "board": BOARD,
        "sensor": SimpleNamespace(file_descriptor=4),
        "hurried": True,
    }


def test_it_waits_for_the_first_message(wires, monkeypatch):
    """And ends without one."""
    threading.Timer(0.2, lambda: wires[0].send(rig=DATA, port=PORT, given_name=PORT)).start()
    with unopened(monkeypatch, Noting(), lambda: wires[0].send(command="end_session")) as made:
        process.serve_parent(wires[1])
        assert made["sensor_port"] is None
    monkeypatch.setattr(process, "select", SimpleNamespace(select=lambda *_: ([], [], [])))
    assert process.serve_parent(wires[1]) is None


@pytest.mark.parametrize("armed", [False, True])
def test_an_error_is_latched_if_anything_was_armed_and_told_with_its_proof(wires, monkeypatch, armed):
    controller = Noting()
    controller.armed_once = armed
    answers, _, said = guarded(wires, monkeypatch, controller, {"command": "stop", "reason": "a key"})
    why = "a key; everything was switched off" + ("; proven by this test" if armed else "")
    stopped = {
        "event": "stopped",
        "reason": why,
        "kind": "StoppedError",
        "code": "run.stopped",
        "proof": "proven by this test",
    }
    assert answers[1:] == [{"event": "opening"}, stopped]
    assert said == "" and controller.told[-1] == ("stop", "a key")
    if armed:
        assert find_record(PORT).stop == "a key" and find_record(PORT).opened is not None
    else:
        assert find_record(PORT) is None


def test_what_is_not_proven_bears_no_proof(wires, monkeypatch):
    controller = Noting()
    controller.armed_once = True
    controller.fails["stopping"] = ContactError("channel 2 is closed")
    answers, _, said = guarded(wires, monkeypatch, controller, {"command": "stop", "reason": "a key"})
    why = f"{UNPROVEN}a key"
    assert answers[-1]["kind"] == "NotProvenOffError" and answers[-1]["proof"] is None and said == ""
    assert answers[-1]["reason"] == why
    record = find_record(PORT)
    assert record.stop == why and record.opened is None


def test_an_error_that_is_not_proven_off_is_latched_at_once(wires, monkeypatch):
    controller = Noting()
    controller.fails["step"] = NotProvenOffError("channel 2 did not switch")
    answers, _, _ = guarded(wires, monkeypatch, controller)
    assert controller.told == [] and answers[-1]["reason"] == "channel 2 did not switch"
    assert find_record(PORT).stop == "channel 2 did not switch" and find_record(PORT).opened is None


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
        "event": "stopped",
        "reason": why,
        "kind": "CurrentFlowsError",
        "code": "heat.current-flows",
        "proof": None,
    }
    assert controller.told == [("stop", str(first))]
    if same or armed:
        assert find_record(PORT).stop == why and find_record(PORT).opened is None
    else:
        assert find_record(PORT) is None


def test_an_error_without_words_is_latched_by_its_name(wires, monkeypatch):
    controller = Noting()
    controller.armed_once = True
    controller.fails["step"] = ZeroDivisionError()
    with pytest.raises(ZeroDivisionError):
        guarded(wires, monkeypatch, controller)
    assert (
        controller.told == [("stop", "ZeroDivisionError")] and find_record(PORT).stop == "ZeroDivisionError"
    )


@pytest.mark.parametrize("proven", [True, False])
def test_where_the_program_has_died_the_terminal_is_told(wires, monkeypatch, proven):
    """Above all where the board does not confirm that everything is off."""
    controller = Noting()
    controller.armed_once = True
    if not proven:
        controller.fails["stopping"] = ContactError("channel 2 is closed")
    wires[0].send(rig=DATA, port=PORT, given_name=PORT)
    wires[0].close()
    said = io.StringIO()
    with unopened(monkeypatch, controller), redirect_stderr(said):
        process.serve_parent(wires[1])
    died = "the program that heats has died"
    told = f"{died}; proven by this test" if proven else f"{UNPROVEN}{died}"
    assert said.getvalue() == f"eldir: {PORT}: {told}\n"


@pytest.mark.parametrize("proven", [True, False])
def test_where_the_program_hangs_the_terminal_is_told_what_is_not_proven(wires, monkeypatch, proven):
    controller = Noting()
    controller.armed_once = True
    controller.fails["step"] = KeepaliveError("no keepalive message of the program that heats for 0.7 s")
    if not proven:
        controller.fails["stopping"] = ContactError("channel 2 is closed")
    _, _, said = guarded(wires, monkeypatch, controller)
    assert said == (
        ""
        if proven
        else f"eldir: {PORT}: {UNPROVEN}no keepalive message of the program that heats for 0.7 s\n"
    )


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

    def guard(wire: GuardianConnection) -> None:
        served.append(wire.fileno())
        wire._end.detach()
        raise BrokenPipeError  # nobody reads what it prints

    monkeypatch.setattr(process, "serve_parent", guard)
    monkeypatch.setattr(sys, "argv", ["eldir-guardian", "word", str(wires[1].fileno()), "port"])
    process.main()
    assert served == [wires[1].fileno()]
    assert select.select([wires[0]], [], [], 0) == ([], [], []), "still open"


def test_errors_of_the_session_are_errors_of_eldir():
    assert issubclass(process.ParentDiedError, EldirError)
