"""A port whose output is held up: by another program's `tcflow`, by a flow control, by the device.

Pseudo-terminals stop for `tcflow` and XOFF as any port does; `HeldUart` adds the queue of a real adapter,
which takes bytes and sends none.
"""

import os
import platform
import subprocess
import sys
import termios
import time
from contextlib import contextmanager

import pytest

from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.rig.devices import get_driver
from eldir_hardware.testing import close_contacts
from tests.hardware.emulated_rigs import emulated, heating_program, in_turn, rig_file, wait
from tests.hardware.relay.held_serial_output import NUMBERS, HeldUart

pytestmark = pytest.mark.skipif(platform.machine() not in NUMBERS, reason="of other system calls")
OFF = [sys.executable, "-m", "eldir", "rig", "off"]
SAID, OPENED = 1.0, 0.5
"""Limits from the fault until the words, and until the last contact opens [s]."""
BUSY = 3.0  # start and end of a program of Python, on a busy computer [s]


def suspend(board) -> None:
    termios.tcflow(board.client_end, termios.TCOOFF)


def xoff(board) -> None:
    mode = termios.tcgetattr(board.client_end)
    mode[0] |= termios.IXON
    termios.tcsetattr(board.client_end, termios.TCSANOW, mode)
    for _ in range(3):  # a driver that discards its input at the same instant discards an XOFF too
        os.write(board._board_end, b"\x13")
        time.sleep(0.005)


HOLDS = (suspend, xoff, "queue")
BOARDS = ("lcus", "modbus", "mosfet")
"""Without a timer, with one, and with a heartbeat of its own; all write by way of the same module."""


def heats_off_after(board, held_at: float) -> float:
    """When the last contact opened; none may have closed after the first that opened."""
    first = next(i for i, edge in enumerate(board.contact_events) if not edge.closed)
    assert not any(edge.closed for edge in board.contact_events[first:]), board.contact_events
    return board.contact_events[-1].t - held_at


@pytest.mark.parametrize(("kind", "hold"), in_turn(installed_kinds(), HOLDS))
def test_output_that_another_program_stopped_is_started_again(tmp_path, kind, hold):
    with emulated(kind) as board, HeldUart(board.port) as uart:
        rig = rig_file(tmp_path / "rig.yaml", kind, board.port)
        before = uart.code if hold == "queue" else ""
        with heating_program(board, rig, before, child_guardian=bool(before)) as (program, _):
            held_at = time.monotonic()
            uart.hold(restarts=True) if hold == "queue" else hold(board)
            _, told = program.communicate(timeout=15)
            took = time.monotonic() - held_at
        assert "accepts no more bytes" in told and "all contacts are open by the board's report" in told, told
        assert not any(board.contacts) and heats_off_after(board, held_at) < OPENED
        assert took < SAID + BUSY


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=[] if k in BOARDS else pytest.mark.stress) for k in installed_kinds()],
)
def test_a_device_that_takes_no_more_bytes_is_said_at_once(tmp_path, kind):
    """Nothing but the board's own timer and the cut-off opens the contacts: the words must not wait.

    Without a timer, with one, and with a heartbeat of its own. All boards write by way of
    `eldir_hardware._serial_output`.
    """
    with emulated(kind) as board, HeldUart(board.port) as uart:
        rig = rig_file(tmp_path / "rig.yaml", kind, board.port)
        with heating_program(board, rig, uart.code, child_guardian=True) as (program, _):
            held_at = time.monotonic()
            uart.hold(restarts=False)
            _, told = program.communicate(timeout=15)
            took = time.monotonic() - held_at
        assert "accepts no more bytes" in told and "cut the heating supply now" in told, told
        assert "all contacts are open" not in told
        assert took < SAID + BUSY
        assert uart.queue == b"", "what waited would close contacts later"
        if get_driver(kind).times_pulses:
            assert wait(lambda: not any(board.contacts), 1.0)


@pytest.mark.parametrize(("kind", "hold"), in_turn(installed_kinds(), HOLDS))
def test_off_starts_stopped_output_again(kind, hold):
    with emulated(kind) as board, HeldUart(board.port) as uart, nobody_drives(board):
        before = uart.words if hold == "queue" else []
        uart.hold(restarts=True) if hold == "queue" else hold(board)
        began = time.monotonic()
        done = run_off(before, board.port, "--board", kind)
        assert done.returncode == 0 and "are open by the board's report" in done.stdout, done
        assert not any(board.contacts) and heats_off_after(board, began) < OPENED + BUSY


@pytest.mark.parametrize(
    "known",
    [None, *(pytest.param(k, marks=[] if k == "mosfet" else pytest.mark.stress) for k in installed_kinds())],
)
def test_off_says_at_once_that_a_device_takes_nothing(known):
    with emulated(known or "lcus") as board, HeldUart(board.port) as uart, nobody_drives(board):
        uart.hold(restarts=False)
        began = time.monotonic()
        done = run_off(uart.words, board.port, *(["--board", known] if known else []))
        took = time.monotonic() - began
        assert done.returncode == 1 and "accepts no more bytes" in done.stdout, done
        assert "cut the heating supply now" in done.stderr
        assert took < SAID + BUSY, done


def run_off(before, port, *words) -> subprocess.CompletedProcess:
    command = [*before, *OFF, "--port", port, *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)


@contextmanager
def nobody_drives(board):
    """Contacts 1 and 3 are closed."""
    close_contacts(board, (1, 3))
    assert wait(lambda: board.contacts[0] and board.contacts[2])
    yield
