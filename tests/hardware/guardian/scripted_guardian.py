"""A guardian whose process is played by the test: scripted answers, and a virtual clock."""

import os
import select
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from eldir_hardware.guardian import client
from eldir_hardware.guardian._connection import GuardianConnection
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.rig.board_identity import identify
from tests.hardware.rigs_and_schedules import rig_with

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


@contextmanager
def scripted_guardian(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    """Guardians whose processes answer as the tests say, on a virtual clock."""
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
