"""A controller of the guardian's process that records its orders, and the wire to a program."""

import signal
import socket
import time

import pytest

from eldir_hardware.guardian._connection import GuardianConnection
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import find_record, read_stop
from eldir_hardware.safety.spring_memory import SpringHeat
from tests.hardware.rigs_and_schedules import rig_with

PORT = "/dev/ttyUSB70"
REAL = rig_with(kind="real", board={"port": PORT}, camera=None)
WARM = {1: SpringHeat((61.5, 70.25), (0.25, 0.0), ((12.0, 7.0),))}


class RecordingController:
    """A controller that records its orders; `fails` raises from an order."""

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


@pytest.fixture
def signals():
    """Those of the tests, afterwards."""
    numbers = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
    before = [signal.getsignal(n) for n in numbers]
    yield
    signal.set_wakeup_fd(-1)
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.fixture
def wires(tmp_path, monkeypatch, signals):
    """Both ends of a wire, the program's and the guardian's; no other records, and the signals of the tests
    afterwards."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    ends = [GuardianConnection(end) for end in socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)]
    yield ends
    for end in ends:
        end.close()


def told(wire: GuardianConnection) -> list[dict]:
    """The messages that have arrived."""
    return wire.receive() or []
