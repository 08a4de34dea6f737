"""The guardian writes its log where nobody reads it: heat ends as early as without a log."""

import os
import pty
import signal
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest

from eldir_hardware.safety.latch import GUARDIAN_DIED, read_stop
from eldir_hardware.safety.spring_memory import load_springs
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import HEAT, emulated, in_turn, rig_file, wait

LIMIT = 1.0
"""From the death of the program that heats until every contact is open [s]."""


Stall = Callable[[], None]


@contextmanager
def unread_pipe() -> Iterator[tuple[int, Stall]]:
    read, write = os.pipe()
    with os.fdopen(read), os.fdopen(write, "w"):

        def fill() -> None:
            with suppress(BlockingIOError):
                while True:
                    os.pwritev(write, [b"." * 100], -1, os.RWF_NOWAIT)

        yield write, fill


@contextmanager
def stopped_terminal() -> Iterator[tuple[int, Stall]]:
    """As by Ctrl-S."""
    host, guest = pty.openpty()
    with os.fdopen(host), os.fdopen(guest, "w"):
        tty.setraw(guest)
        yield guest, lambda: termios.tcflow(guest, termios.TCOOFF)


@contextmanager
def pipe_without_reader() -> Iterator[tuple[int, Stall]]:
    read, write = os.pipe()
    with os.fdopen(write, "w"):
        yield write, lambda: os.close(read)


@contextmanager
def full_disk() -> Iterator[tuple[int, Stall]]:
    with open("/dev/full", "w") as file:
        yield file.fileno(), lambda: None


@pytest.mark.parametrize(
    ("stalled", "number"),
    in_turn(
        [unread_pipe, stopped_terminal, pipe_without_reader, full_disk], [signal.SIGKILL, signal.SIGTERM]
    ),
)
def test_a_log_that_nobody_takes_delays_no_off(stalled, number, tmp_path):
    """`SIGKILL`: of the program that heats. `SIGTERM`: to the guardian, as `eldir rig off` sends it."""
    with emulated("lcus") as board, stalled() as (stderr, stall):
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        program = Forked(
            [sys.executable, "-c", HEAT, str(path)],
            stdout=subprocess.PIPE, stderr=stderr, env=os.environ | {"ELDIR_LOG": "debug"},
        )  # fmt: skip
        try:
            guardian = int(program.stdout.readline())
            assert wait(lambda: board.contacts[:4] == (True, False, True, False))
            stall()
            asked = time.monotonic()
            os.kill(program.pid if number == signal.SIGKILL else guardian, number)
            assert wait(lambda: not any(board.contacts))
            assert wait(lambda: load_springs(board.port) is not None), "it ends its work"
        finally:
            program.kill()
            program.communicate()
        opened = max(edge.t for edge in board.contact_events if not edge.closed) - asked
        assert opened < LIMIT, opened
        assert read_stop(board.port) not in (None, GUARDIAN_DIED)
    assert wait(lambda: not os.path.exists(f"/proc/{guardian}"))


def test_the_guardian_says_what_it_does_and_who_it_is(tmp_path):
    """It inherits the level; its frames are those that open the contacts after its parent's death."""
    with emulated("lcus") as board, (tmp_path / "err.txt").open("w") as file:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        program = Forked(
            [sys.executable, "-c", HEAT, str(path)],
            stdout=subprocess.PIPE, stderr=file,
            env=os.environ | {"ELDIR_LOG": "eldir_hardware.relay=debug,info"},
        )  # fmt: skip
        guardian = int(program.stdout.readline())
        assert wait(lambda: board.contacts[:4] == (True, False, True, False))
        program.kill()
        program.communicate()
        assert wait(lambda: not os.path.exists(f"/proc/{guardian}"))
    lines = [line.split(maxsplit=2) for line in (tmp_path / "err.txt").read_text().splitlines()]
    said = [rest for _, level, rest in lines if level in ("DEBUG", "INFO")]
    assert said[0] == f"guardian eldir_hardware.relay.line: opened {board.port} at 9600 baud"
    assert f"guardian eldir_hardware.relay.line: to {board.port}: a0 01 01 a2" in said, "channel 1 closes"
    assert said[-1].startswith("guardian eldir_hardware.guardian._process: stopped, ") or any(
        "the program that heats has died" in line for line in said
    )
    off = max(i for i, line in enumerate(said) if line.endswith(": a0 01 00 a1"))
    assert off > said.index(f"guardian eldir_hardware.relay.line: to {board.port}: a0 01 01 a2")
    assert all(line.startswith("guardian eldir_hardware.") for line in said), (
        "this program has no log of its own"
    )
    assert not any(level == "DEBUG" and "eldir_hardware.relay" not in rest for _, level, rest in lines)
