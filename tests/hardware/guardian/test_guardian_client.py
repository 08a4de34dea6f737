"""What the program does with each answer of its guardian."""

import os
import signal
from contextlib import nullcontext

import pytest

from eldir.errors import EldirError, InputError
from eldir_hardware.guardian._connection import clean_environment, guardian_command
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.relay.errors import ContactError, NotProvenOffError, PortError
from eldir_hardware.rig.supply import LimitError
from tests.hardware.guardian.scripted_guardian import NOT_PROVEN, PORT, RIG, STOPPED, armed, opened
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises


def test_how_the_process_is_started(desk):
    guardian, child = opened(sensor={"kind": "ina226", "port": "/dev/sensor"})
    handle = child.options.pop("pass_fds")[0]
    assert child.command == guardian_command(handle, PORT, RIG.board.kind, RIG.board.channels, PORT)
    assert child.options == {
        "stdin": -3,
        "stdout": -3,
        "env": clean_environment(),
        "cwd": "/",
        "start_new_session": True,
    }
    first = child.heard()[0]
    assert first == {
        "rig": guardian._rig.to_json(),
        "port": PORT,
        "given_name": PORT,
        "sensor_port": "/dev/sensor",
    }
    assert guardian.process == 4321


@pytest.mark.parametrize(
    ("given", "sent"),
    [
        ({}, (PORT, None)),
        ({"port": "a"}, (os.path.abspath("a"), None)),
        ({"sensor_port": "b"}, (PORT, os.path.abspath("b"))),
    ],
    ids=str,
)
def test_the_ports_that_it_is_told(desk, given, sent):
    guardian = Guardian(RIG, **given)
    guardian.open()
    message = guardian._process.heard()[0]
    assert (message["port"], message["sensor_port"]) == sent


def test_the_sensors_port_of_the_rig_file_is_replaced(desk):
    rig = rig_with(board={"port": PORT}, sensor={"kind": "ina226", "port": "/dev/sensor"})
    assert Guardian(rig, sensor_port="/dev/other")._sensor_port == "/dev/other"
    assert Guardian(rig)._sensor_port == "/dev/sensor"


def test_a_rig_without_a_port(desk):
    with raises(InputError, "rig.no-port", match=r"set board\.port"):
        Guardian(rig_with(board={"port": None}))


def test_a_rig_that_is_no_message(desk):
    rig = rig_with().model_copy(update={"name": "x" * (1 << 16)})
    with raises(InputError, "rig.too-large", match="at most 64 KiB"):
        Guardian(rig, "/dev/port").open()


def test_only_the_process_holds_its_end(desk):
    """Otherwise nobody would notice that it has died."""
    guardian, child = opened()
    child.wire.close()
    with raises(EldirError, "guardian.not-armed", match="see its message above"):
        guardian.keep_alive()
    assert child.done == [("wait", 2.0)]
    guardian.stop("later")


def test_one_that_a_signal_ends_before_it_is_armed_has_no_message_above(desk):
    guardian, child = opened()
    child.wire.close()
    child.status = -signal.SIGTERM
    with raises(EldirError, "guardian.not-armed", match="by SIGTERM") as caught:
        guardian.keep_alive()
    assert "message above" not in str(caught.value)


def test_one_that_the_kernel_holds_before_it_is_armed_is_not_waited_for(desk):
    guardian, child = opened()
    child.wire.close()
    child.hangs = True
    with raises(EldirError, "guardian.not-armed"):
        guardian.keep_alive()
    assert child.done == [("wait", 2.0)]


def test_a_start_that_fails_leaves_no_process(desk):
    desk.popen.first = [
        {"event": "stopped", "reason": "cannot open the port", "kind": "PortError", "proof": None}
    ]
    guardian = Guardian(RIG)
    with pytest.raises(PortError, match="cannot open the port"):
        guardian.open()
    assert guardian._process.heard()[-1] == {"command": "end_session"} and guardian._process.done == [
        ("wait", 2.0)
    ]
    assert guardian._process.wire.receive() is None


def test_a_process_that_dies_at_once(desk):
    desk.popen.first = None
    with raises(EldirError, "guardian.not-armed"):
        Guardian(RIG).open()
    assert desk.time.now == 1000.0


def test_a_start_that_takes_too_long(desk):
    desk.popen.first = []
    guardian = Guardian(RIG)
    with pytest.raises(NotProvenOffError, match="the guardian does not answer; cut the heating supply now"):
        guardian.open()
    assert desk.time.now == pytest.approx(1020.0)
    assert max(desk.time.waits) == 0.1, "it goes on beating"
    beats = [m for m in guardian._process.heard() if m == {"command": "keepalive"}]
    assert 199 <= len(beats) <= 201


def test_the_end(desk):
    guardian, child = opened()
    child.heard()
    guardian.close()
    assert child.heard() == [{"command": "end_session"}] and child.done == [("wait", 10.0)]
    assert child.wire.receive() is None, "its wire is closed"


def test_an_end_that_the_process_does_not_reach(desk):
    guardian, child = opened()
    child.hangs = True
    guardian.close()
    assert child.done == [("wait", 10.0), "kill", ("wait", 2.0)], (
        "nor is one waited for that the kernel holds"
    )


def test_orders(desk):
    guardian, child = armed()
    guardian.heat(1.5, {1: 2.0})
    guardian.abort_pulses()
    assert child.heard() == [
        {"command": "heat", "at": 1.5, "durations": {"1": 2.0}},
        {"command": "abort_pulses"},
    ]
    child.wire.send(**{"event": "off"})
    guardian.disarm()
    assert child.heard() == [{"command": "disarm"}]


def test_a_beat_passes_reports_and_refusals(desk):
    guardian, child = armed()
    seen: list[Report] = []
    report = Report(1.0, (True, False), (40.0,), 41.0, 0.01)
    child.wire.send(**{"event": "report", "report": report})
    child.wire.send(**{"event": "acknowledged"})
    guardian.keep_alive(seen.append)
    assert seen == [report] and child.heard() == [{"command": "keepalive"}]
    child.wire.send(**{"event": "refused", "reason": "too long", "code": "limit.long-pulse"})
    with raises(LimitError, "limit.long-pulse"):
        guardian.keep_alive()


def test_resting_beats_ten_times_a_second(desk):
    guardian, child = armed()
    child.wire.send(**{"event": "acknowledged"})
    guardian.wait_until(desk.time.now + 0.45)
    assert desk.time.now == pytest.approx(1000.45)
    assert desk.time.waits == [pytest.approx(0.1)] * 4 + [pytest.approx(0.05)]
    assert child.heard() == [{"command": "keepalive"}] * 6
    guardian.wait_until(desk.time.now)
    assert len(desk.time.waits) == 5, "the instant itself is not waited for"


@pytest.mark.parametrize("kind", ["ContactError", "NoSuchError"])
def test_a_stop_of_the_guardian_is_raised(desk, kind):
    guardian, child = armed()
    child.wire.send(**{"event": "stopped", "reason": "channel 2", "kind": kind, "proof": None})
    with pytest.raises(ContactError if kind == "ContactError" else EldirError, match="channel 2"):
        guardian.keep_alive()
    child.heard()
    guardian.stop("later")
    assert child.heard() == [], "it has stopped already"


def test_a_stop_is_answered_by_its_reason(desk):
    guardian, child = armed()
    child.wire.send(**STOPPED)
    guardian.stop("a key")
    assert child.heard()[0] == {"command": "stop", "reason": "a key"} and guardian.proof == "all open"
    guardian, child = armed()
    child.wire.send(**NOT_PROVEN)
    with pytest.raises(NotProvenOffError):
        guardian.stop("a key")


@pytest.mark.parametrize("together", [True, False], ids=["one batch", "one after the other"])
def test_refused_pulses_do_not_hide_how_a_stop_ended(desk, together):
    """They were announced before the stop was read."""
    for answer in (STOPPED, NOT_PROVEN):
        guardian, child = armed()
        for number in range(3):
            child.wire.send(**{"event": "refused", "reason": f"pulse {number}"})
        if together:
            child.wire.send(**answer)
        else:
            desk.time.at[desk.time.now + 0.3] = lambda answer=answer, wire=child.wire: wire.send(**answer)
        with pytest.raises(NotProvenOffError) if answer is NOT_PROVEN else nullcontext():
            guardian.stop("a key")
        assert guardian.proof == answer["proof"]


def test_a_refusal_does_not_hide_reports_that_come_with_it(desk):
    guardian, child = armed()
    seen: list[Report] = []
    report = Report(1.0, (True, False), (40.0,), 41.0, 0.01)
    child.wire.send(**{"event": "refused", "reason": "too long", "code": "limit.long-pulse"})
    child.wire.send(**{"event": "refused", "reason": "too hot"})
    child.wire.send(**{"event": "report", "report": report})
    with raises(LimitError, "limit.long-pulse"):
        guardian.keep_alive(seen.append)
    assert seen == [report], "and the first refusal is told"
