"""What the program does when its guardian dies, hangs, or loses its port."""

import os
import tty
from contextlib import contextmanager

import pytest

from eldir.errors import EldirError
from eldir_hardware.guardian import client
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.measured_heat import CurrentFlowsError
from eldir_hardware.relay.errors import ContactError, NotProvenOffError, PortError
from eldir_hardware.rig.board_identity import identify
from eldir_hardware.safety.latch import find_record, latch, read_stop
from eldir_hardware.safety.off_frames import off_frames
from eldir_hardware.safety.stop_signals import StoppedError
from tests.hardware.guardian.scripted_guardian import ARMED, PORT, READY, RIG, armed, opened
from tests.raised import raises


@pytest.mark.parametrize(
    "interrupt", [KeyboardInterrupt(), StoppedError("stopped by SIGTERM")], ids=["Ctrl-C", "SIGTERM"]
)
def test_a_signal_while_the_contacts_are_opened_from_here(desk, interrupt):
    """It ends the run, not the opening: that begins again, and its outcome counts."""
    for fails, proven in (([interrupt], True), ([interrupt, ContactError("channel 1 is closed")], False)):
        desk.opens, desk.fails = [], list(fails)
        guardian, child = armed()
        child.wire.close()
        outcome = pytest.raises(type(interrupt) if proven else NotProvenOffError)
        with outcome as raised, guardian_armed_already(guardian):
            guardian.keep_alive()
        assert desk.opens == ([PORT, "off", ("sensor", None)] if proven else [])
        if proven:
            assert raised.value.__notes__ == ["all contacts are open by the board's report"]
        if not proven:
            assert "channel 1 is closed; cut the heating supply now" in str(raised.value)


@contextmanager
def guardian_armed_already(guardian: Guardian):
    """`HeaterBank.armed` without arming again."""
    guardian.arm = lambda: None
    with guardian.armed():
        yield


def test_a_killed_guardian_that_the_kernel_holds(desk):
    """It holds the port's lock too. The contacts are opened all the same, and nobody claims to know it."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    desk.popen.first = [READY | {"device": identify(os.ttyname(theirs)).to_json()}]
    guardian = Guardian(RIG, port=os.ttyname(theirs))
    guardian.open()
    child = guardian._process
    child.wire.send(**ARMED)
    guardian.arm()
    child.hangs = True
    with pytest.raises(NotProvenOffError, match=r"process does not end.*; cut the heating supply now"):
        guardian.wait_until(desk.time.now + 5)
    assert child.done == ["kill", ("wait", 2.0)] and desk.opens == []
    assert os.read(ours, 1000) == off_frames(RIG.board.kind, RIG.board.channels)
    assert guardian.proof is None
    os.close(ours)
    os.close(theirs)


def test_a_guardian_that_hangs(desk):
    """Its process is killed, and the contacts are opened from here."""
    guardian, child = armed()
    with raises(EldirError, "guardian.gone", match=r"hung; all contacts are open by the board's report$"):
        guardian.wait_until(desk.time.now + 5)
    assert 1000.6 < desk.time.now < 1000.75
    assert child.done == ["kill", ("wait", 2.0)]
    assert desk.opens == [PORT, "off", ("sensor", None)]
    assert read_stop(PORT) == "the guardian hung"
    child.heard()
    guardian.stop("later")
    assert child.heard() == [], "nobody hears it"


def test_a_guardian_that_answers_late_but_in_time(desk):
    guardian, child = armed()
    for t in (0.55, 1.1, 1.6):
        desk.time.at[1000 + t] = lambda: child.wire.send(**{"event": "acknowledged"})
    guardian.wait_until(desk.time.now + 2.0)
    assert child.done == []


def test_a_guardian_that_opens_the_contacts_may_take_longer(desk):
    guardian, child = armed()
    desk.time.at[1000.5] = lambda: child.wire.send(**{"event": "opening"})
    desk.time.at[1005.0] = lambda: child.wire.send(**{"event": "off"})
    guardian.disarm()
    assert child.done == [] and desk.time.now >= 1005
    desk.time.now += 100
    guardian.wait_until(desk.time.now + 5)  # nothing heats: nobody needs to answer
    assert child.done == []


def test_a_report_of_open_contacts_does_not_hurry_the_disk_that_keeps_the_state(desk):
    """The guardian reports what it proved, and then writes to the disk, which may be busy for seconds."""
    guardian, child = armed()
    opened = Report(1000.6, (False, False), (40.0,), 41.0, 0.01)
    desk.time.at[1000.5] = lambda: child.wire.send(**{"event": "opening"})
    desk.time.at[1000.6] = lambda: child.wire.send(**{"event": "report", "report": opened})
    desk.time.at[1005.0] = lambda: child.wire.send(**{"event": "off"})
    guardian.disarm()
    assert child.done == [] and desk.time.now >= 1005


def test_a_guardian_that_hangs_before_it_opens_the_contacts(desk):
    guardian, child = armed()
    with raises(EldirError, "guardian.gone", match="hung"):
        guardian.disarm()
    assert desk.time.now < 1000.75 and child.done[0] == "kill"


def test_a_guardian_that_hangs_while_it_opens_the_contacts(desk):
    guardian, child = armed()
    desk.time.at[1000.5] = lambda: child.wire.send(**{"event": "opening"})
    with raises(EldirError, "guardian.gone", match="hung"):
        guardian.wait_until(desk.time.now + 60)
    assert 1010.9 < desk.time.now < 1011.3


def test_arming_that_is_not_answered(desk):
    guardian, child = opened()
    with pytest.raises(NotProvenOffError, match="the guardian does not answer"):
        guardian.arm()
    assert desk.time.now == pytest.approx(1010.0)
    assert child.heard()[1] == {"command": "arm"}


def test_a_program_that_stood_still_waits_once_more_and_only_once(desk):
    guardian, child = armed()
    guardian.keep_alive()
    desk.time.now += 2.0
    guardian.keep_alive()
    assert child.done == [], "its answers may be on their way"
    desk.time.now += 0.25
    guardian.keep_alive()
    assert child.done == []
    desk.time.now += 0.1
    with raises(EldirError, "guardian.gone", match="hung"):
        guardian.keep_alive()


def test_a_guardian_that_has_died(desk):
    guardian, child = armed()
    child.wire.close()
    desk.measured = "no current flows"
    with raises(
        EldirError,
        "guardian.gone",
        match="died; all contacts are open by the board's report; no current flows",
    ):
        guardian.keep_alive()
    assert child.done == [("wait", 2.0)] and read_stop(PORT) == "the guardian died"
    assert find_record(PORT).opened is not None


def test_a_guardian_that_was_killed_by_rig_off(desk):
    guardian, child = armed()
    latch(PORT, "stopped by eldir rig off")
    child.wire.close()
    with raises(
        EldirError, "guardian.gone", match=r"died \(stopped by eldir rig off\); all contacts are open"
    ):
        guardian.keep_alive()
    assert read_stop(PORT) == "stopped by eldir rig off"


def test_a_guardian_that_has_died_where_its_latch_cannot_be_read(desk, monkeypatch):
    guardian, child = armed()

    def unreadable(port: str) -> str:
        raise EldirError("cannot be trusted")

    monkeypatch.setattr(client, "read_stop", unreadable)
    child.wire.close()
    with raises(EldirError, "guardian.gone", match="died; all contacts are open"):
        guardian.keep_alive()


def test_a_guardian_that_has_died_with_its_port(desk, tmp_path):
    port = tmp_path / "port"
    port.touch()
    desk.popen.first = [READY | {"device": {"name": str(port), "marks": ["path:1", f"link:{port}"]}}]
    guardian = Guardian(RIG, port=str(port))
    guardian.open()
    guardian._process.wire.send(**ARMED)
    guardian.arm()
    port.unlink()
    desk.fails = [PortError("cannot open it")]
    guardian._process.wire.close()
    with pytest.raises(
        NotProvenOffError,
        match=rf"the guardian died, and the port {port} was lost, and the contacts cannot be opened: "
        "cannot open it; cut the heating supply now",
    ):
        guardian.keep_alive()
    assert find_record(str(port)).opened is None


@pytest.mark.parametrize(
    ("measured", "kind", "text"),
    [
        (CurrentFlowsError("0.5 A flow"), CurrentFlowsError, "^0.5 A flow; the guardian died$"),
        (
            EldirError("silent"),
            EldirError,
            "open by the board.*, but not proven by the sensor: silent$",
        ),
    ],
)
def test_what_the_sensor_says_after_a_guardian_has_died(desk, measured, kind, text):
    guardian, child = armed()
    desk.measured = measured
    child.wire.close()
    with pytest.raises(kind, match=text):
        guardian.keep_alive()


def test_a_port_that_rig_off_holds_is_waited_for(desk, monkeypatch):
    guardian, child = armed()
    desk.fails = [PortError("another program has it open") for _ in range(5)]
    holders = []
    monkeypatch.setattr(client, "find_holder", lambda port: holders.append(str(port)) or "another")
    child.wire.close()
    with raises(EldirError, "guardian.gone", match="all contacts are open"):
        guardian.keep_alive()
    assert holders == [PORT] * 5 and desk.time.now == pytest.approx(1000.1)


@pytest.mark.parametrize("held", [False, True])
def test_a_port_that_stays_closed(desk, monkeypatch, held):
    """Nobody holds it: it is tried once. Another program holds it: for three seconds."""
    guardian, child = armed()
    desk.fails = [PortError("cannot open it") for _ in range(1000)]
    monkeypatch.setattr(client, "find_holder", lambda port: "another" if held else None)
    child.wire.close()
    with pytest.raises(NotProvenOffError, match="the contacts cannot be opened: cannot open it"):
        guardian.keep_alive()
    assert desk.time.now == pytest.approx(1003.02 if held else 1000.0, abs=0.011)
    assert desk.opens == [] and read_stop(PORT) == "the guardian died"


def test_contacts_that_are_not_proven_open_are_not_tried_again(desk, monkeypatch):
    guardian, child = armed()
    desk.fails = [NotProvenOffError("channel 2 did not switch")]
    monkeypatch.setattr(client, "find_holder", lambda port: "another")
    child.wire.close()
    with pytest.raises(NotProvenOffError, match="channel 2 did not switch"):
        guardian.keep_alive()
    assert desk.opens == []
