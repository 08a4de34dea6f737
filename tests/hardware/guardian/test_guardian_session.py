"""What the guardian's process answers and does to each message; its controller only records its orders."""

import os
import signal
import time
from types import SimpleNamespace

import pytest

from eldir.errors import EldirError
from eldir_hardware.guardian import _process as process
from eldir_hardware.guardian._connection import GuardianConnection
from eldir_hardware.guardian.bank import Report
from eldir_hardware.relay.errors import ContactError, NotProvenOffError
from eldir_hardware.safety.latch import (
    GUARDIAN_DIED,
    LatchedError,
    find_record,
    latch,
    latch_for_driving,
    unlatch,
)
from eldir_hardware.safety.spring_memory import load_springs
from eldir_hardware.safety.stop_signals import StoppedError
from tests.hardware.guardian.recording_controller import PORT, REAL, WARM, RecordingController, told
from tests.hardware.rigs_and_schedules import RIG
from tests.raised import raises


def served(
    wires: list[GuardianConnection],
    *messages: dict,
    controller: RecordingController | None = None,
    end: bool = True,
) -> RecordingController:
    """Serve these messages, and the end of the session."""
    controller = controller or RecordingController()
    session = process._Session(wires[1], controller, RIG, PORT)
    for message in (*messages, *([{"command": "end_session"}] if end else [])):
        wires[0].send(**message)
    session.run()
    return controller


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
    session = process._Session(wires[1], RecordingController(), REAL, PORT)
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
    refused = RecordingController()
    refused.fails["arming"] = EldirError("the board says no")
    with pytest.raises(EldirError, match="says no"):
        process._Session(wires[1], refused, REAL, PORT)._obey({"command": "arm"})
    assert load_springs(PORT).keys() == WARM.keys() and find_record(PORT) is None


def test_springs_count_as_hot_where_it_cannot_be_written_how_hot_they_are(wires, monkeypatch):
    session = process._Session(wires[1], RecordingController(), REAL, PORT)
    session._obey({"command": "arm"})

    def full(*given: object) -> None:
        raise EldirError("cannot write")

    monkeypatch.setattr(process, "save_springs", full)
    session._obey({"command": "disarm"})
    assert told(wires[0])[-1] == {"event": "off"} and load_springs(PORT) is None


def test_nothing_arms_while_a_stop_is_latched(wires):
    latch(PORT, "too hot")
    controller = RecordingController()
    with pytest.raises(LatchedError, match="too hot"):
        served(wires, {"command": "arm"}, controller=controller)
    assert controller.told == ["beat"]


def test_a_stop_while_it_arms_is_kept(wires, monkeypatch):
    """Of another user, who cannot signal this process, while the board is asked for its limits."""
    controller = RecordingController()
    monkeypatch.setattr(controller, "check_limits", lambda: latch(PORT, "anna stopped it"))
    with pytest.raises(LatchedError, match="anna stopped it"):
        served(wires, {"command": "arm"}, controller=controller)
    assert controller.told == ["beat"] and find_record(PORT).stop == "anna stopped it"


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
    session = process._Session(wires[1], RecordingController(), RIG, PORT)
    os.kill(os.getpid(), number)
    with pytest.raises(StoppedError, match=f"stopped by {number.name}, such as `eldir rig off` sends"):
        session.run()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


@pytest.mark.parametrize("signalled", [False, True])
def test_an_error_behind_a_signal_is_its_consequence(wires, signalled):
    """`eldir rig off` opens the contacts, and then they do not follow."""
    controller = RecordingController()
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

    controller = RecordingController()
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
    controller = RecordingController()
    controller.armed_once = armed_before
    controller.fails["arming"] = error
    with pytest.raises(type(error)):
        served(wires, {"command": "arm"}, controller=controller)
    proven = not armed_before and isinstance(error, ContactError)
    assert controller.told[3:] == ([("stop", "no fit")] if proven else [])
    assert (find_record(PORT) is None) is proven
