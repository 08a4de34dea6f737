"""What the program does with each answer of its guardian: scripted answers, and a virtual clock."""

import os
import select
import signal
import socket
import subprocess
import tty
from contextlib import contextmanager, nullcontext
from types import SimpleNamespace

import pytest

from eldir.errors import EldirError, InputError
from eldir_hardware.guardian import client
from eldir_hardware.guardian._connection import GuardianConnection, clean_environment, guardian_command
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.measured_heat import CurrentFlowsError
from eldir_hardware.relay.errors import ContactError, NotProvenOffError, PortError
from eldir_hardware.rig.board_identity import identify
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import find_record, latch, read_stop
from eldir_hardware.safety.off_frames import off_frames
from eldir_hardware.safety.stop_signals import StoppedError
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

PORT = "/dev/null"  # it exists, and nothing opens it here
RIG = rig_with(board={"port": PORT})
READY = {"event": "ready", "process": 4321, "device": identify(PORT).to_json(), "sensor": None}
ARMED = {"event": "armed", "ready_at": 990.0}
STOPPED = {"event": "stopped", "reason": "a key; all open", "kind": "StoppedError", "proof": "all open"}
NOT_PROVEN = {"event": "stopped", "reason": "not proven", "kind": "NotProvenOffError", "proof": None}


class Time:
    """A clock that `select` moves on, where nothing is there to be read."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.waits: list[float] = []
        self.at: dict[float, object] = {}
        """What is called when the clock has come so far."""

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def select(self, sources: list, writers: list, errors: list, timeout: float):
        ready = select.select(sources, [], [], 0)
        if not ready[0]:
            self.waits.append(timeout)
            self.now += timeout
            for t in sorted(t for t in self.at if t <= self.now):
                self.at.pop(t)()
        return ready


class Child:
    """The guardian's process."""

    pid = 1
    status = 1

    def __init__(self, command: list[str], **options) -> None:
        self.command, self.options = command, options
        self.done: list[object] = []
        self.hangs = False
        (handle,) = options["pass_fds"]
        self.wire = GuardianConnection(socket.socket(fileno=os.dup(handle)))
        self.made.append(self)
        for answer in self.first or ():
            self.wire.send(**answer)
        if self.first is None:
            self.wire.close()

    def wait(self, timeout: float | None = None) -> int:
        self.done.append(("wait", timeout))
        if self.hangs and timeout is not None:
            raise subprocess.TimeoutExpired("guardian", timeout)
        return self.status

    def kill(self) -> None:
        self.done.append("kill")

    def heard(self) -> list[dict]:
        return self.wire.receive() or []


class Desk:
    """What the tests can see and change."""

    def __init__(self) -> None:
        self.time = Time()
        self.opens: list[object] = []
        self.fails: list[Exception] = []
        self.measured: object = None

    def rig_opened(self, rig, port):
        if self.fails:
            raise self.fails.pop(0)
        self.opens.append(str(port))
        board = SimpleNamespace(all_off=lambda: self.opens.append("off"))

        class Opened:
            def __enter__(self):
                return board

            def __exit__(self, *error):
                return None

        return Opened()

    def require_no_current(self, rig, port, supplied):
        self.opens.append(("sensor", port))
        if isinstance(self.measured, Exception):
            raise self.measured
        return self.measured


@pytest.fixture
def desk(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    desk = Desk()
    popen = type("Popen", (Child,), {"first": [READY], "made": []})
    wires: list[GuardianConnection] = []

    class KeptConnection(GuardianConnection):
        def __init__(self, end: socket.socket) -> None:
            super().__init__(end)
            wires.append(self)

    monkeypatch.setattr(client, "GuardianConnection", KeptConnection)
    monkeypatch.setattr(client, "time", desk.time)
    monkeypatch.setattr(client, "select", desk.time)
    monkeypatch.setattr(
        client,
        "subprocess",
        SimpleNamespace(Popen=popen, DEVNULL=-3, TimeoutExpired=subprocess.TimeoutExpired),
    )
    monkeypatch.setattr(client, "open_board", desk.rig_opened)
    monkeypatch.setattr(client, "require_no_current", desk.require_no_current)
    desk.popen = popen
    yield desk
    for wire in [*wires, *(child.wire for child in popen.made)]:
        wire.close()


def opened(**changes: object) -> tuple[Guardian, Child]:
    guardian = Guardian(rig_with(board={"port": PORT}, **changes))
    guardian.open()
    return guardian, guardian._process


def armed() -> tuple[Guardian, Child]:
    guardian, child = opened()
    child.wire.send(**ARMED)
    guardian.arm()
    assert guardian.ready_at == 990.0
    child.heard()
    return guardian, child


def ignore(report: Report) -> None:
    """Nobody looks."""


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
        guardian.keep_alive(ignore)
    assert child.done == [("wait", 2.0)]
    guardian.stop("later")


def test_one_that_a_signal_ends_before_it_is_armed_has_no_message_above(desk):
    guardian, child = opened()
    child.wire.close()
    child.status = -signal.SIGTERM
    with raises(EldirError, "guardian.not-armed", match="by SIGTERM") as caught:
        guardian.keep_alive(ignore)
    assert "message above" not in str(caught.value)


def test_one_that_the_kernel_holds_before_it_is_armed_is_not_waited_for(desk):
    guardian, child = opened()
    child.wire.close()
    child.hangs = True
    with raises(EldirError, "guardian.not-armed"):
        guardian.keep_alive(ignore)
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
        guardian.keep_alive(ignore)


def test_resting_beats_ten_times_a_second(desk):
    guardian, child = armed()
    child.wire.send(**{"event": "acknowledged"})
    guardian.wait_until(desk.time.now + 0.45, ignore)
    assert desk.time.now == pytest.approx(1000.45)
    assert desk.time.waits == [pytest.approx(0.1)] * 4 + [pytest.approx(0.05)]
    assert child.heard() == [{"command": "keepalive"}] * 6
    guardian.wait_until(desk.time.now, ignore)
    assert len(desk.time.waits) == 5, "the instant itself is not waited for"


@pytest.mark.parametrize("kind", ["ContactError", "NoSuchError"])
def test_a_stop_of_the_guardian_is_raised(desk, kind):
    guardian, child = armed()
    child.wire.send(**{"event": "stopped", "reason": "channel 2", "kind": kind, "proof": None})
    with pytest.raises(ContactError if kind == "ContactError" else EldirError, match="channel 2"):
        guardian.keep_alive(ignore)
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
            guardian.keep_alive(ignore)
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
        guardian.wait_until(desk.time.now + 5, ignore)
    assert child.done == ["kill", ("wait", 2.0)] and desk.opens == []
    assert os.read(ours, 1000) == off_frames(RIG.board.kind, RIG.board.channels)
    assert guardian.proof is None
    os.close(ours)
    os.close(theirs)


def test_a_guardian_that_hangs(desk):
    """Its process is killed, and the contacts are opened from here."""
    guardian, child = armed()
    with raises(EldirError, "guardian.gone", match=r"hung; all contacts are open by the board's report$"):
        guardian.wait_until(desk.time.now + 5, ignore)
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
    guardian.wait_until(desk.time.now + 2.0, ignore)
    assert child.done == []


def test_a_guardian_that_opens_the_contacts_may_take_longer(desk):
    guardian, child = armed()
    desk.time.at[1000.5] = lambda: child.wire.send(**{"event": "opening"})
    desk.time.at[1005.0] = lambda: child.wire.send(**{"event": "off"})
    guardian.disarm()
    assert child.done == [] and desk.time.now >= 1005
    desk.time.now += 100
    guardian.wait_until(desk.time.now + 5, ignore)  # nothing heats: nobody needs to answer
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
        guardian.wait_until(desk.time.now + 60, ignore)
    assert 1010.9 < desk.time.now < 1011.3


def test_arming_that_is_not_answered(desk):
    guardian, child = opened()
    with pytest.raises(NotProvenOffError, match="the guardian does not answer"):
        guardian.arm()
    assert desk.time.now == pytest.approx(1010.0)
    assert child.heard()[1] == {"command": "arm"}


def test_a_program_that_stood_still_waits_once_more_and_only_once(desk):
    guardian, child = armed()
    guardian.keep_alive(ignore)
    desk.time.now += 2.0
    guardian.keep_alive(ignore)
    assert child.done == [], "its answers may be on their way"
    desk.time.now += 0.25
    guardian.keep_alive(ignore)
    assert child.done == []
    desk.time.now += 0.1
    with raises(EldirError, "guardian.gone", match="hung"):
        guardian.keep_alive(ignore)


def test_a_guardian_that_has_died(desk):
    guardian, child = armed()
    child.wire.close()
    desk.measured = "no current flows"
    with raises(
        EldirError,
        "guardian.gone",
        match="died; all contacts are open by the board's report; no current flows",
    ):
        guardian.keep_alive(ignore)
    assert child.done == [("wait", 2.0)] and read_stop(PORT) == "the guardian died"
    assert find_record(PORT).opened is not None


def test_a_guardian_that_was_killed_by_rig_off(desk):
    guardian, child = armed()
    latch(PORT, "stopped by eldir rig off")
    child.wire.close()
    with raises(
        EldirError, "guardian.gone", match=r"died \(stopped by eldir rig off\); all contacts are open"
    ):
        guardian.keep_alive(ignore)
    assert read_stop(PORT) == "stopped by eldir rig off"


def test_a_guardian_that_has_died_where_its_latch_cannot_be_read(desk, monkeypatch):
    guardian, child = armed()

    def unreadable(port: str) -> str:
        raise EldirError("cannot be trusted")

    monkeypatch.setattr(client, "read_stop", unreadable)
    child.wire.close()
    with raises(EldirError, "guardian.gone", match="died; all contacts are open"):
        guardian.keep_alive(ignore)


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
        guardian.keep_alive(ignore)
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
        guardian.keep_alive(ignore)


def test_a_port_that_rig_off_holds_is_waited_for(desk, monkeypatch):
    guardian, child = armed()
    desk.fails = [PortError("another program has it open") for _ in range(5)]
    holders = []
    monkeypatch.setattr(client, "find_holder", lambda port: holders.append(str(port)) or "another")
    child.wire.close()
    with raises(EldirError, "guardian.gone", match="all contacts are open"):
        guardian.keep_alive(ignore)
    assert holders == [PORT] * 5 and desk.time.now == pytest.approx(1000.1)


@pytest.mark.parametrize("held", [False, True])
def test_a_port_that_stays_closed(desk, monkeypatch, held):
    """Nobody holds it: it is tried once. Another program holds it: for three seconds."""
    guardian, child = armed()
    desk.fails = [PortError("cannot open it") for _ in range(1000)]
    monkeypatch.setattr(client, "find_holder", lambda port: "another" if held else None)
    child.wire.close()
    with pytest.raises(NotProvenOffError, match="the contacts cannot be opened: cannot open it"):
        guardian.keep_alive(ignore)
    assert desk.time.now == pytest.approx(1003.02 if held else 1000.0, abs=0.011)
    assert desk.opens == [] and read_stop(PORT) == "the guardian died"


def test_contacts_that_are_not_proven_open_are_not_tried_again(desk, monkeypatch):
    guardian, child = armed()
    desk.fails = [NotProvenOffError("channel 2 did not switch")]
    monkeypatch.setattr(client, "find_holder", lambda port: "another")
    child.wire.close()
    with pytest.raises(NotProvenOffError, match="channel 2 did not switch"):
        guardian.keep_alive(ignore)
    assert desk.opens == []
