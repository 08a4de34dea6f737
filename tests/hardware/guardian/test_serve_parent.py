"""The guardian's process from its first message to its end, without its port; see also
`test_guardian_session.py`."""

import gc
import io
import os
import select
import sys
import threading
from contextlib import contextmanager, redirect_stderr
from types import SimpleNamespace

import pytest

from eldir.errors import EldirError
from eldir_hardware.guardian import _process as process
from eldir_hardware.guardian._connection import GuardianConnection
from eldir_hardware.guardian.measured_heat import CurrentFlowsError
from eldir_hardware.guardian.pulse_controller import KeepaliveError
from eldir_hardware.realtime import GUARDIAN
from eldir_hardware.relay.errors import ContactError, NotProvenOffError
from eldir_hardware.rig.board_identity import BoardIdentity
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.latch import find_record, require_not_stopped
from eldir_hardware.safety.spring_memory import load_springs, save_springs
from tests.hardware.guardian.recording_controller import PORT, REAL, RecordingController, told
from tests.hardware.rigs_and_schedules import RIG

UNPROVEN = (
    "not proven that everything is off: channel 2 is closed; cut the heating supply now; "
    "it was stopped because: "
)
BOARD = SimpleNamespace(file_descriptor=3)


@contextmanager
def unopened(monkeypatch, controller: RecordingController, ready=lambda: None):
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

    def controlled(board, rig, clock, sensor, springs, host) -> RecordingController:
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
        patch.setattr(process, "_prepare_for_real_time", lambda: made.update(hurried=True))
        yield made


def guarded(
    wires, monkeypatch, controller: RecordingController, *messages: dict, rig: Rig = RIG
) -> tuple[list[dict], dict, str]:
    """Serve a program that sends these messages; what it is told, with what it was made, and stderr."""

    def speak() -> None:
        for message in messages:
            wires[0].send(**message)

    wires[0].send(rig=rig.to_json(), port=PORT, given_name=PORT, sensor_port="/dev/sensor")
    said = io.StringIO()
    with unopened(monkeypatch, controller, speak) as made, redirect_stderr(said):
        process.serve_parent(wires[1])
    return told(wires[0]), made, said.getvalue()


def test_a_session_from_its_first_message_to_its_end(wires, monkeypatch):
    answers, made, said = guarded(
        wires, monkeypatch, RecordingController(), {"command": "keepalive"}, {"command": "end_session"}
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
    threading.Timer(0.2, lambda: wires[0].send(rig=RIG.to_json(), port=PORT, given_name=PORT)).start()
    with unopened(monkeypatch, RecordingController(), lambda: wires[0].send(command="end_session")) as made:
        process.serve_parent(wires[1])
        assert made["sensor_port"] is None
    monkeypatch.setattr(process, "select", SimpleNamespace(select=lambda *_: ([], [], [])))
    assert process.serve_parent(wires[1]) is None


@pytest.mark.parametrize(
    ("fails", "known"),
    [({}, True), ({"stopping": ContactError("channel 2 is closed")}, False),
     ({"step": NotProvenOffError("channel 2 did not switch")}, False)],
    ids=["proven off", "not proven", "not proven at once"],
)  # fmt: skip
def test_a_stop_tells_how_hot_the_springs_are_if_it_is_proven(wires, monkeypatch, fails, known):
    controller = RecordingController()
    controller.armed_once = True
    controller.fails = fails
    save_springs(PORT, None)
    guarded(wires, monkeypatch, controller, {"command": "stop", "reason": "a key"}, rig=REAL)
    assert (load_springs(PORT) is not None) is known


@pytest.mark.parametrize("armed", [False, True])
def test_an_error_is_latched_if_anything_was_armed_and_told_with_its_proof(wires, monkeypatch, armed):
    controller = RecordingController()
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
    controller = RecordingController()
    controller.armed_once = True
    controller.fails["stopping"] = ContactError("channel 2 is closed")
    answers, _, said = guarded(wires, monkeypatch, controller, {"command": "stop", "reason": "a key"})
    why = f"{UNPROVEN}a key"
    assert answers[-1]["kind"] == "NotProvenOffError" and answers[-1]["proof"] is None and said == ""
    assert answers[-1]["reason"] == why
    record = find_record(PORT)
    assert record.stop == why and record.opened is None


def test_an_error_that_is_not_proven_off_is_latched_at_once(wires, monkeypatch):
    controller = RecordingController()
    controller.fails["step"] = NotProvenOffError("channel 2 did not switch")
    answers, _, _ = guarded(wires, monkeypatch, controller)
    assert controller.told == [] and answers[-1]["reason"] == "channel 2 did not switch"
    assert find_record(PORT).stop == "channel 2 did not switch" and find_record(PORT).opened is None


@pytest.mark.parametrize("first", [CurrentFlowsError("0.5 A flow"), ContactError("no answer")])
@pytest.mark.parametrize("armed", [False, True])
def test_current_that_flows_though_all_contacts_are_open(wires, monkeypatch, first, armed):
    """Nothing else matters then; it is latched even where nothing was armed."""
    controller = RecordingController()
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
    controller = RecordingController()
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
    controller = RecordingController()
    controller.armed_once = True
    if not proven:
        controller.fails["stopping"] = ContactError("channel 2 is closed")
    wires[0].send(rig=RIG.to_json(), port=PORT, given_name=PORT)
    wires[0].close()
    said = io.StringIO()
    with unopened(monkeypatch, controller), redirect_stderr(said):
        process.serve_parent(wires[1])
    died = "the program that heats has died"
    told = f"{died}; proven by this test" if proven else f"{UNPROVEN}{died}"
    assert said.getvalue() == f"eldir: {PORT}: {told}\n"


@pytest.mark.parametrize("proven", [True, False])
def test_where_the_program_hangs_the_terminal_is_told_what_is_not_proven(wires, monkeypatch, proven):
    controller = RecordingController()
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

    monkeypatch.setattr(process, "request_realtime_priority", done.append)
    process._prepare_for_real_time()
    assert done == ["collect", "freeze", GUARDIAN]


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
