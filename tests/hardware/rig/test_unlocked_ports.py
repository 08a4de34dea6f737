"""How a port is written that another program holds."""

import errno
import fcntl
import os
import termios
import time

import pytest

from eldir_hardware._serial_output import BlockedOutputError
from eldir_hardware.safety.off_frames import UnlockedPort
from tests.hardware.rig.pseudo_terminal import terminal

PORT = "/dev/null"


def mode_of(port: str) -> list:
    handle = os.open(port, os.O_RDWR | os.O_NOCTTY)
    try:
        return termios.tcgetattr(handle)
    finally:
        os.close(handle)


@pytest.mark.parametrize("baud", [9600, 19200, 38400, 57600, 115200, 1234])
def test_the_bytes_and_the_mode_of_a_free_port(baud):
    """Raw: no byte is changed, added or echoed. An unknown speed is 9600."""
    with terminal() as (host, name):
        port = UnlockedPort(name)
        port.send(b"\n\r\x03\x11\xff", baud, is_held=False)
        assert os.read(host, 100) == b"\n\r\x03\x11\xff"
        found = mode_of(name)
        speed = getattr(termios, f"B{baud}", termios.B9600)
        assert found[:2] == [0, 0] and found[3] == 0 and found[4:6] == [speed, speed]
        assert found[2] & ~(termios.CBAUD | termios.CBAUDEX if hasattr(termios, "CBAUDEX") else 0o10017) == (
            termios.CS8 | termios.CREAD | termios.CLOCAL
        )
        port.close()


def test_the_mode_of_a_port_that_another_program_holds_is_left(monkeypatch):
    with terminal() as (host, name):
        before = mode_of(name)
        port = UnlockedPort(name)
        assert os.get_blocking(port._handle) is False
        assert fcntl.fcntl(port._handle, fcntl.F_GETFD) == fcntl.FD_CLOEXEC
        port.send(b"off", 115200, is_held=True)
        before[0] &= ~(termios.IXON | termios.IXOFF | termios.IXANY)  # any byte of a board could stop it
        assert mode_of(name) == before and os.read(host, 100) == b"off"
        port.send(b"", 9600, is_held=False)
        calls = []
        monkeypatch.setattr(termios, "tcsetattr", lambda *_: calls.append("set"))
        port.send(b"", 9600, is_held=False)
        assert calls == [], "it is as it should be already"
        port.close()
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(port._handle)


def test_a_port_that_takes_few_bytes_at_a_time_or_none(monkeypatch):
    """It is tried for its time on the wire and 0.2 s more, then said."""
    written: list[bytes] = []

    def write(handle: int, data: bytes) -> int:
        if len(written) < 3:
            written.append(data[:2])
            return 2
        raise BlockingIOError

    with terminal() as (_, name):
        port = UnlockedPort(name)
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", write)
            port.send(b"abcdef", 9600, is_held=True)
            assert written == [b"ab", b"cd", b"ef"]
            begun = time.monotonic()
            with pytest.raises(BlockedOutputError, match="accepts no more bytes"):
                port.send(bytes(96), 9600, is_held=True)
            assert 0.3 <= time.monotonic() - begun < 0.8
        port.close()


def test_a_port_that_is_lost_while_it_is_written(monkeypatch):
    """The proof will tell."""
    with terminal() as (_, name):
        port = UnlockedPort(name)

        def lost(*_: object) -> int:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

        with monkeypatch.context() as patch:
            patch.setattr(os, "write", lost)
            port.send(b"abc", 9600, is_held=True)
        port.close()


def test_files_that_are_no_serial_ports(tmp_path):
    before = len(os.listdir("/proc/self/fd"))
    for name in (PORT, str(tmp_path)):
        with pytest.raises(OSError, match="it is not a serial port") as caught:
            UnlockedPort(name)
        assert caught.value.errno == errno.ENOTTY
    assert len(os.listdir("/proc/self/fd")) == before


def test_whether_a_port_is_free():
    with terminal() as (_, name):
        port = UnlockedPort(name)
        assert port.is_free() is True
        other = os.open(name, os.O_RDWR | os.O_NOCTTY)
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)  # it was given back
        assert port.is_free() is False
        os.close(other)
        assert port.is_free() is True
        port.close()
