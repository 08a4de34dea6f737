"""What ends a bank, and the wire between a guardian and its program."""

import socket

import pytest

from eldir.errors import EldirError
from eldir_hardware.guardian._connection import GuardianConnection
from eldir_hardware.guardian.bank import HeaterBank
from eldir_hardware.relay.errors import ContactError, NotProvenOffError
from eldir_hardware.safety.stop_signals import StoppedError


class Noting(HeaterBank):
    """A bank that notes what it is told."""

    def __init__(self, failing: BaseException | None = None) -> None:
        self.told: list[str] = []
        self._failing = failing

    def arm(self) -> None:
        self.told.append("arm")
        if self._failing:
            raise self._failing

    def heat(self, at, lengths) -> None:
        self.told.append("heat")

    def abort_pulses(self) -> None:
        self.told.append("cut")

    def wait_until(self, t, see) -> None:
        self.told.append("rest")

    def disarm(self) -> None:
        self.told.append("disarm")

    def stop(self, why: str) -> None:
        self.told.append(f"stop: {why}")


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (KeyboardInterrupt(), "stopped by Ctrl-C"),
        (StoppedError("a key"), "a key"),
        (ValueError("no number"), "no number"),
        (ValueError(), "ValueError"),
        (SystemExit(3), "3"),
    ],
)
@pytest.mark.parametrize("when", ["arming", "heating"])
def test_every_way_out_of_a_bank_but_the_end_is_a_stop(error, why, when):
    bank = Noting(error if when == "arming" else None)
    with pytest.raises(type(error)), bank.armed():
        raise error
    assert bank.told == ["arm", f"stop: {why}"]


@pytest.mark.parametrize(
    ("error", "notes"),
    [
        (KeyboardInterrupt(), ["all open"]),
        (EldirError("the disk is full"), ["all open"]),
        (ContactError("channel 2 did not switch; all open"), []),
        (NotProvenOffError("not proven"), []),
    ],
)
def test_an_error_bears_what_was_proven_once(error, notes):
    """But none that says that nothing is proven."""
    bank = Noting()
    bank.proof = "all open"
    with pytest.raises(type(error)), bank.armed():
        raise error
    assert getattr(error, "__notes__", []) == notes


def test_the_good_end_of_a_bank():
    bank = Noting()
    with bank.armed():
        bank.heat(1.0, {})
    assert bank.told == ["arm", "heat", "disarm"]


# The wire between guardian and program.


def test_messages_of_the_wire_arrive_whole_and_in_order(wires):
    ours, theirs = wires
    assert theirs.receive() == []
    ours.send(command="keepalive")
    ours.send(command="heat", at=1.5)
    assert theirs.receive() == [{"command": "keepalive"}, {"command": "heat", "at": 1.5}]
    theirs.send(rig="x" * 60_000)
    assert ours.receive() == [{"rig": "x" * 60_000}]
    assert theirs.fileno() >= 0 and theirs.receive() == []


def test_a_wire_never_blocks(wires):
    """What the other end does not take is dropped."""
    ours, theirs = wires
    for number in range(3000):
        ours.send(number=number)
    taken = theirs.receive()
    assert 1 < len(taken) < 3000 and [m["number"] for m in taken] == list(range(len(taken)))


@pytest.mark.parametrize("unread", [False, True])
def test_the_other_end_of_a_wire_has_gone(wires, unread):
    """The last messages are still read, also where it had not read ours."""
    ours, theirs = wires
    if unread:
        theirs.send(command="keepalive")
    ours.send(command="end_session")
    ours.close()
    assert theirs.receive() == [{"command": "end_session"}]
    assert theirs.receive() is None
    theirs.send(command="keepalive")


def test_a_closed_wire_is_gone(wires):
    ours, _ = wires
    ours.close()
    assert ours.receive() is None


@pytest.fixture
def wires():
    """Both ends of a wire."""
    pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ends = [GuardianConnection(end) for end in pair]
    yield ends
    for end in ends:
        end.close()
