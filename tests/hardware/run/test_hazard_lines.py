"""What a person reads when a contact is stuck and something else goes wrong too: real processes."""

import ctypes
import fcntl
import os
import pty
import re
import resource
import signal
import subprocess
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from select import select

import pytest

from eldir.errors import EldirError, report
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.log.reader import read_log
from eldir_hardware.relay.errors import ContactError
from eldir_hardware.resource import Resource
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import open_board
from eldir_hardware.safety.latch import read_stop
from eldir_hardware.safety.stop_signals import StopSignals
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import emulated, rig_file, wait
from tests.hardware.run.fault_matrix import prepared, strike
from tests.hardware.run.faults import ELDIR, FAULTS, LIVES, STUCK, guardian_of

_SEIZE, _ANY_CHILD = 0x4206, 0x40000000  # PTRACE_SEIZE, __WALL


IN_BRIEF = ("contact stuck, SIGHUP, SIGTERM in turn", "contact stuck, full disk, SIGINT repeated")


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(f, marks=[] if f in IN_BRIEF else pytest.mark.stress)
        for f in FAULTS
        if f.startswith("contact stuck, ") and FAULTS[f].says
    ],
)
def test_what_is_hot_is_printed_first_and_once(fault, tmp_path):
    outcome = strike(tmp_path, "lcus", fault, seed=1, cycles=1)
    print(f"\n{outcome}")
    assert not outcome.wrong
    lines = [line for t, line in outcome.lines if t > 0]
    assert re.search(STUCK, lines[0]) and len([1 for line in lines if "cut the heating" in line]) == 1
    assert outcome.status == (130 if lines[-1] == "eldir: stopped" else 1)
    assert not any("Traceback" in line for line in lines)


class Lost(Resource):
    """A log that cannot be finished."""

    def open(self) -> None:
        pass

    def close(self) -> None:
        raise EldirError("cannot write the log")


@pytest.mark.parametrize(
    ("error", "said"),
    [(ContactError("channel 2 is hot"), "channel 2 is hot"), (KeyboardInterrupt(), "stopped by Ctrl-C")],
)
def test_a_log_that_cannot_be_finished_is_told_behind_it(error, said, capsys):
    def run() -> None:
        with Lost(), StopSignals().handled():
            if isinstance(error, KeyboardInterrupt):
                error.add_note("all open")
            raise error

    with pytest.raises(type(error)) as raised:
        try:
            run()
        except KeyboardInterrupt:  # as the command line's parser does
            raise KeyboardInterrupt from None
    report(raised.value)
    proof = "; all open" if isinstance(error, KeyboardInterrupt) else ""
    assert capsys.readouterr().err == f"eldir: {said}{proof}\neldir: cannot write the log\n"


class Terminal:
    """A program on a terminal of its own, and what it shows there."""

    def __init__(self, words: list[str]):
        self._host, guest = pty.openpty()
        self.program = subprocess.Popen(
            words,
            stdin=guest,
            stdout=guest,
            stderr=guest,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 # no lock is held here
        )
        os.close(guest)
        self._read, self.open = b"", True
        self._reader = threading.Thread(target=self._show, daemon=True)
        self._reader.start()

    def _show(self) -> None:
        with suppress(OSError):
            while self.open:
                if not select([self._host], [], [], 0.05)[0]:
                    continue
                self._read += os.read(self._host, 4096)

    def type(self, key: bytes) -> None:
        with suppress(OSError):
            os.write(self._host, key)

    def close(self) -> None:
        if self.open:
            self.open = False
            self._reader.join()  # a terminal that is read is not closed
            os.close(self._host)

    @property
    def shown(self) -> str:
        """What was shown, on one line and without the codes that move the cursor."""
        self._reader.join(5.0)
        return " ".join(re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b" ", self._read).decode().split())


@contextmanager
def stuck_while_driven(
    folder: Path, start: Callable[[list[str]], object]
) -> Iterator[tuple[EmulatedBoard, object]]:
    """`eldir rig drive` on a board of which one closed contact just became stuck, as the board reports."""
    board, _, _, words = prepared(folder, "lcus")
    driving = start(words)
    program = getattr(driving, "program", driving)
    try:
        assert wait(lambda: any(board.contacts) or program.poll() is not None, 40.0)
        assert program.poll() is None
        channel = board.contacts.index(True) + 1
        board.faults.welded.add(channel)
        board.faults.deaf.add(channel)
        yield board, driving
        others = [closed for c, closed in enumerate(board.contacts, start=1) if c != channel]
        assert not any(others) and read_stop(board.port) is not None
    finally:
        program.kill()
        program.wait()
        board.close()


def test_ctrl_c_is_held_down(tmp_path):
    """Thirty times a second, as a keyboard repeats it."""
    with stuck_while_driven(tmp_path, Terminal) as (_, terminal):
        while terminal.program.poll() is None:
            terminal.type(b"\x03")
            with suppress(subprocess.TimeoutExpired):
                terminal.program.wait(1 / 30)
        shown = terminal.shown
        assert re.search(STUCK, shown), shown
        assert "Traceback" not in shown and terminal.program.returncode in (1, 130)
        terminal.close()


def test_a_terminal_that_is_closed(tmp_path):
    """Nobody can read there what is hot: the log and the latched stop tell it."""
    with stuck_while_driven(tmp_path, Terminal) as (board, terminal):
        terminal.close()
        assert terminal.program.wait(20) == 1
        assert re.search(STUCK, read_stop(board.port) or "")
        ends = [text for _, part, text in read_log(tmp_path / "log.mcap").statuses if part == "player"]
        assert re.search(STUCK, ends[-1])


def test_a_disk_is_full_where_stderr_is_written_too(tmp_path):
    """The terminal that the program was started from says what is hot."""
    heard = []

    def start(words: list[str]) -> Terminal:
        return Terminal(["sh", "-c", 'exec "$@" >/dev/null 2>"$0"', str(tmp_path / "err.txt"), *words])

    with stuck_while_driven(tmp_path, start) as (_, terminal):
        resource.prlimit(terminal.program.pid, resource.RLIMIT_FSIZE, (1, 1))
        assert terminal.program.wait(20) == 1
        heard.append(terminal.shown)
        terminal.close()
    assert re.search(f"{STUCK}.*cannot (write|be written)", heard[0])


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.stress), signal.SIGHUP]
)
def test_the_emergency_stop_says_what_is_not_proven(number, tmp_path):
    """Whatever signals come, and though its report cannot be written."""
    with emulated("lcus") as board, open("/dev/full", "w") as full:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        with open_board(Rig.load(path)) as driver:
            driver.switch({2: True})
        board.faults.welded.add(2)
        board.faults.deaf.add(2)
        before = board._bytes_received
        with subprocess.Popen(
            [*ELDIR, "rig", "off", "--rig", str(path)], stdout=full, stderr=subprocess.PIPE, text=True
        ) as off:
            assert wait(lambda: board._bytes_received > before)
            while off.poll() is None:
                off.send_signal(number)
                with suppress(subprocess.TimeoutExpired):
                    off.wait(0.05)
            said = off.stderr.read().splitlines()
        assert said[0] == (
            f"eldir: not proven that everything is off at {board.port}; cut the heating supply now"
        )
        assert off.returncode == 1 and not any("Traceback" in line for line in said)


def test_a_guardian_that_the_kernel_holds_is_not_waited_for(tmp_path):
    """Traced by this test, it is killed and does not end; the contacts open before that is waited for."""
    board, _, _, words = prepared(tmp_path, "lcus")
    with Forked(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, child_guardian=True) as player:
        assert wait(lambda: any(board.contacts) or player.poll() is not None, 40.0)
        guardian = guardian_of(board)
        assert guardian is not None
        if ctypes.CDLL(None, use_errno=True).ptrace(_SEIZE, guardian, None, None):
            player.kill()
            pytest.skip(f"this system traces no process: {os.strerror(ctypes.get_errno())}")
        try:
            assert wait(lambda: any(board.contacts))
            os.kill(guardian, signal.SIGKILL)
            killed = time.monotonic()
            said = player.stderr.read() if wait(lambda: player.poll() is not None, 20.0) else ""
            ended = time.monotonic() - killed
        finally:
            player.kill()
            os.waitpid(guardian, _ANY_CHILD)
            board.close()
    assert not any(board.contacts)
    opened = max(e.t for e in board.contact_events if not e.closed) - killed
    assert opened < LIVES < 2.0 < ended, (opened, ended)
    assert (
        "the guardian's process does not end, and holds the port" in said
        and "cut the heating supply now" in said
    )
    assert player.returncode == 1
