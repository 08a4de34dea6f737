"""The serial line under every driver, on real pseudo-terminals: what is lost, late, stale or refused.

On a port of these tests: how many bytes are asked for, and when.
"""

import errno
import os
import time
import tty
from contextlib import contextmanager, suppress

import pytest

from eldir_hardware.clock import VirtualClock, WallClock
from eldir_hardware.relay.errors import BlockedPortError, GarbledReplyError, PortError, SilentBoardError
from eldir_hardware.relay.line import SerialLine, _reason
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.testing import powered


@contextmanager
def wired(clock=None, baud: int = 9600):
    """A line and the other end of its pseudo-terminal, which nobody serves."""
    host, guest = os.openpty()
    tty.setraw(host)
    tty.setraw(guest)
    line = SerialLine(os.ttyname(guest), baud, clock or WallClock())
    try:
        yield line, host
    finally:
        line.close()
        for handle in (host, guest):
            with suppress(OSError):
                os.close(handle)


def test_ten_bits_a_byte():
    with wired(baud=19200) as (line, _):
        assert line.wire_time(96) == pytest.approx(0.05)


def test_what_is_written_arrives_and_is_counted():
    with wired() as (line, host):
        line.write(b"abc")
        line.write(b"de")
        found = os.read(host, 100)
        while len(found) < 5:
            found += os.read(host, 100)
        assert found == b"abcde" and line.bytes_written == 5


def test_an_answer_may_take_its_wire_time_and_some_patience():
    """0.2 s of patience on the wall clock beyond eleven bytes of 1.04 ms: no answer costs so long."""
    with wired() as (line, _):
        begun = time.monotonic()
        with pytest.raises(SilentBoardError, match=r"did not answer; expected 10 bytes; found none"):
            line.query(b"?", 10)
        assert 0.2 <= time.monotonic() - begun < 0.8  # a busy machine included
        begun = time.monotonic()
        with pytest.raises(SilentBoardError, match=r"did not answer; expected bytes up to b'>'; found none"):
            line.query_until(b"?", b">", 10)
        assert 0.2 <= time.monotonic() - begun < 0.8


@pytest.mark.parametrize(
    ("answer", "found"), [(b"12345", b"12345"), (b"1234", None), (b"123456", b"12345"), (b"", None)]
)
def test_an_answer_of_known_length_is_whole_or_an_error(answer, found):
    with wired(VirtualClock()) as (line, host):
        line._clock.patience = 0.05
        drop = line._port.reset_input_buffer
        line._port.reset_input_buffer = lambda: (drop(), os.write(host, answer))  # behind older bytes
        if found is None:
            silent = "did not answer; expected 5 bytes; found none; check its power"
            other = "is too short; expected 5 bytes; found 31 32 33 34; .* 9600 baud .* unit 1"
            error = GarbledReplyError if answer else SilentBoardError
            with pytest.raises(error, match=other if answer else silent):
                line.query(b"??", 5)
        else:
            assert line.query(b"??", 5) == found
            assert line._clock.now() == pytest.approx(7 * 10 / 9600), "question and answer on the wire"


@pytest.mark.parametrize(
    ("answer", "found"), [(b"ab>cd", b"ab>"), (b"abcdef", b"abcd"), (b"ab", b"ab"), (b">", b">")]
)
def test_an_answer_up_to_its_end(answer, found):
    """At most four bytes; one without an end is returned, for the driver to refuse it."""
    with wired(VirtualClock()) as (line, host):
        line._clock.patience = 0.05
        drop = line._port.reset_input_buffer
        line._port.reset_input_buffer = lambda: (drop(), os.write(host, answer))
        assert line.query_until(b"?", b">", 4) == found


@pytest.mark.parametrize("kind", installed_kinds())
def test_stale_input_is_dropped(kind):
    """An answer that came too late, and reports contacts open: it must not pass for the present state."""
    with powered(kind) as p:
        p.board.read_states()
        answers: list[bytes] = []
        answer = p.emulated.send_answer
        p.emulated.send_answer = lambda data: (answers.append(data), answer(data))
        p.board.read_states()
        p.board.switch(dict.fromkeys(range(1, 5), True))
        for old in answers[: 4 if kind in ("feedback", "gd32") else 1]:
            os.write(p.emulated._board_end, old)
        assert p.board.read_states() == (True,) * 4


def test_a_lost_port_is_said():
    with wired() as (line, host):
        os.close(host)
        with pytest.raises(PortError, match=r"was lost: .*; cut the heating supply now"):
            line.write(b"a")
        assert line.bytes_written == 0, "nothing was sent"
        with pytest.raises(PortError, match="was lost"):
            line.query(b"?", 1)


def test_a_line_that_takes_nothing_is_blocked():
    """The other end stands still and its buffer is full: writing ends after the wire time and 0.2 s."""
    with wired() as (line, _):
        with pytest.raises(BlockedPortError, match=r"accepts no more bytes; cut the heating supply now"):
            for _ in range(10000):
                begun = time.monotonic()
                line.write(b"x" * 96)
        assert 0.3 <= time.monotonic() - begun < 0.8
        line.write(b"?")  # what had waited was dropped


def test_why_a_port_cannot_be_opened():
    with wired() as (line, _), pytest.raises(PortError, match="another program has it open"):
        SerialLine(line.url, 9600, WallClock())
    with pytest.raises(PortError, match="No such file or directory"):
        SerialLine("/dev/no-such-port", 9600, WallClock())
    with pytest.raises(PortError, match="cannot open"):
        SerialLine("nonsense://", 9600, WallClock())
    assert _reason(ValueError("said by pyserial")) == "said by pyserial"
    assert _reason(OSError(errno.EACCES, "x")) == "Permission denied"


def test_closing_frees_the_port():
    with wired() as (line, _):
        line.close()
        SerialLine(line.url, 9600, WallClock()).close()


# On a port of these tests.


class Port:
    """A port with bytes to read, which notes how many were asked for, and how long they may take."""

    timeout = 0.0

    def __init__(self, data: bytes):
        self.data, self.reads = data, []

    def read(self, count: int) -> bytes:
        self.reads.append((count, round(self.timeout, 4)))
        found, self.data = self.data[:count], self.data[count:]
        return found

    def reset_input_buffer(self) -> None:
        pass

    def send(self, data: bytes, baud: int, patience: float) -> None:
        pass

    def read_until(self, end: bytes, most: int) -> bytes:
        length = self.data.find(end) + len(end)
        return self.read(length or most)


def line_on(data: bytes) -> SerialLine:
    """A line whose port gives these bytes."""
    line = object.__new__(SerialLine)
    line._clock, line.url, line.baud, line.bytes_written = VirtualClock(), "wire", 9600, 0
    line._port = line._output = Port(data)
    line.sent_at = 0.0
    return line


def test_the_end_of_an_answer_is_noticed_by_a_pause():
    """Not by the time that the longest one would take."""

    line = line_on(b"")
    for answer, reads in ((b"abc", [(2, 1)]), (b"ab", [(2, 1)]), (b"abcdefg", [(2, 1)])):
        line._port = Port(answer)
        assert line.query_until_idle(b"?", 2, 5) == answer, "what is too long is not cut"
        assert [count for count, _ in line._port.reads] == [2, *[1] * (len(answer) - 1)], reads
        assert {t for _, t in line._port.reads[1:]} == {0.06}
    line._port = Port(b"a")
    with pytest.raises(GarbledReplyError, match="expected 2 bytes; found 61;"):
        line.query_until_idle(b"?", 2, 5)


def test_a_port_is_opened_exclusively_and_at_the_boards_speed(monkeypatch):
    done: list[object] = []

    def opened(url: str, **options: object) -> object:
        done.append((url, options))
        return nothing

    monkeypatch.setattr("serial.serial_for_url", opened)
    with open("/dev/null", "rb") as nothing:
        SerialLine("/dev/x", 19200, WallClock())
    assert done == [("/dev/x", {"baudrate": 19200, "exclusive": True})]


def test_questions_that_may_have_no_answer_leave_time_for_it():
    """And the last of them a pause, after which no answer comes any more."""
    line = line_on(b"abcdef")
    written: list[tuple[float, bytes]] = []
    line.write = lambda data: written.append((line._clock.now(), data))
    assert line.query_each([b"12", b"34", b"56"], 3) == b"abcdef"
    assert written == [(0.0, b"12"), (0.0, b"34"), (pytest.approx(5 * 10 / 9600), b"56")]
    assert line._port.reads == [(9, 0.06)]
    assert line._clock.now() == pytest.approx(2 * 5 * 10 / 9600)


def test_behind_a_late_answer_one_more_is_read_and_no_other():
    late = {b"a>": True, b"b>": True}
    line = line_on(b"a>b>c>d>")
    assert line.query_until(b"?", b">", 9, lambda data: late.get(data, False)) == b"c>"
    assert len(line._port.reads) == 3
    line = line_on(b"a>")
    assert line.query_until(b"?", b">", 9, lambda data: late.get(data, False)) == b"a>"
    assert len(line._port.reads) == 2, "nothing follows"
