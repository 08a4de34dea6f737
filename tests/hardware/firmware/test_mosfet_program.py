"""The board's program itself on the real MicroPython, with the real driver on the other end of a terminal.

Only the chip is a double: pins and a watchdog that write down what happens to them.
"""

import json
import os
import subprocess
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from eldir_hardware.clock import WallClock
from eldir_hardware.relay.errors import ContactError, SilentBoardError
from eldir_hardware.relay.mosfet import MosfetBoard
from tests.hardware.emulated_rigs import wait
from tests.hardware.firmware.micropython import cross_compiler, micropython
from tests.paths import ROOT

FIRMWARE = ROOT / "hardware" / "eldir_hardware" / "firmware"
CHIP = """
import os
import sys
import time

PWRON_RESET, WDT_RESET = 1, 3
_trace = open(os.getenv("TRACE"), "w")
_levels = {}


def _tell(text):
    _trace.write('{"t_ms": %d, %s}\\n' % (time.ticks_ms(), text))
    _trace.flush()


class _Interpreter:
    @staticmethod
    def kbd_intr(byte):
        _tell('"interrupted_by": %d' % byte)


sys.modules["micropython"] = _Interpreter


def reset_cause():
    return int(os.getenv("CAUSE"))


class Pin:
    IN, OUT, PULL_UP, PULL_DOWN = 0, 1, 1, 2

    def __init__(self, number, mode, pull=None, value=None):
        self._number = number
        if mode == Pin.OUT:
            _levels[number] = None
            self.value(value)
        else:
            _levels[number] = int(os.getenv("SERVICE"))

    def value(self, level=None):
        if level is None:
            return _levels[self._number]
        if level and self._number == 2:
            raise OSError("the third pin fails")
        if level != _levels[self._number]:
            _levels[self._number] = level
            _tell('"pin": %d, "level": %d' % (self._number, level))


class WDT:
    def __init__(self, timeout):
        self._told = time.ticks_ms()
        _tell('"watchdog": %d' % timeout)

    def feed(self):
        if time.ticks_ms() - self._told >= 50:
            self._told = time.ticks_ms()
            _tell('"fed": 1')
"""


class Bench(NamedTuple):
    """The running program and its terminal."""

    port: str
    trace: Path
    process: subprocess.Popen

    def events(self, name: str) -> list[dict]:
        lines = self.trace.read_text().splitlines() if self.trace.exists() else []
        return [e for e in map(json.loads, lines) if name in e]

    def level(self, pin: int) -> int:
        return next((e["level"] for e in reversed(self.events("pin")) if e["pin"] == pin), -1)


@contextmanager
def running(tmp_path: Path, cause: int = 1, service: int = 1) -> Iterator[Bench]:
    command = micropython()
    (tmp_path / "machine.py").write_text(CHIP)
    start = tmp_path / "start.py"
    start.write_text(f"import sys\nsys.path[:0] = [{str(tmp_path)!r}, {str(FIRMWARE)!r}]\nimport main\n")
    host, guest = os.openpty()
    tty.setraw(host)
    tty.setraw(guest)
    trace = tmp_path / "trace.jsonl"
    environment = os.environ | {"TRACE": str(trace), "CAUSE": str(cause), "SERVICE": str(service)}
    # The driver opens the named end; the program reads and writes the other one.
    with subprocess.Popen([*command, str(start)], stdin=host, stdout=host, env=environment) as process:
        try:
            yield Bench(os.ttyname(guest), trace, process)
        finally:
            process.kill()
            os.close(host)
            os.close(guest)


def test_the_driver_talks_with_the_program(tmp_path: Path) -> None:
    with running(tmp_path) as bench:
        assert wait(lambda: bool(bench.events("fed"))), "the watchdog is fed"
        assert bench.events("watchdog")[0]["watchdog"] < 500
        assert [bench.level(pin) for pin in range(8)] == [0] * 8
        board = MosfetBoard(bench.port, 8, WallClock())
        assert board.read_states() == (False,) * 8
        time.sleep(0.3)  # just powered: the springs may be hot
        board.send({1: True}, {1: 0.1})
        assert wait(lambda: bench.level(0) == 1, 1.0)
        assert wait(lambda: bench.level(0) == 0, 1.0), "by itself"
        assert board.channel_state(1).off_reason == "its time had ended"
        board.switch({1: False, 8: False})
        board.hold({2: 0.3}, 5.0)
        spoken = time.monotonic()
        board.close()
        assert wait(lambda: bench.level(1) == 1, 1.0)
        time.sleep(0.6)
        rises = [e["t_ms"] for e in bench.events("pin") if e["pin"] == 1 and e["level"]]
        falls = [e["t_ms"] for e in bench.events("pin") if e["pin"] == 1 and not e["level"]][1:]
        print(
            f"\nhold at 0.3: high for {[b - a for a, b in zip(rises, falls, strict=True)]} ms of 100 ms each"
        )
        assert 3 <= len(rises) <= 5, "four periods of 0.1 s until the host counts as lost"
        assert falls[-1] - rises[0] < 800 and time.monotonic() - spoken > 0.4
        again = MosfetBoard(bench.port, 8, WallClock())
        with pytest.raises(ContactError, match="it received no command for too long"):
            again._session_open = True  # as the old host would go on
            again.send({2: True}, {2: 0.1})
        again.close()


def test_bytes_of_any_kind_do_not_end_it(tmp_path: Path) -> None:
    """Ctrl-C and Ctrl-D are bytes like others: a program that ends leaves its gates as they are."""
    with running(tmp_path) as bench:
        assert wait(lambda: bool(bench.events("fed")))
        board = MosfetBoard(bench.port, 8, WallClock())
        board._line.write(bytes(range(256)) * 3 + b"\n" + b"\x03\x03\x04")
        time.sleep(0.2)
        assert board.read_states() == (False,) * 8
        assert bench.process.poll() is None
        assert [e["interrupted_by"] for e in bench.events("interrupted_by")] == [-1], "by no byte"
        board.close()


def test_an_error_pulls_every_gate_down_and_starves_the_watchdog(tmp_path: Path) -> None:
    with running(tmp_path) as bench:
        assert wait(lambda: bool(bench.events("fed")))
        board = MosfetBoard(bench.port, 8, WallClock())
        board._open_session()
        time.sleep(0.3)
        board.send({2: True}, {2: 2.0})
        assert wait(lambda: bench.level(1) == 1, 1.0)
        with pytest.raises(SilentBoardError):
            board.send({3: True}, {3: 2.0})  # its pin raises
        assert wait(lambda: bench.level(1) == 0, 1.0)
        fed = len(bench.events("fed"))
        time.sleep(0.4)
        assert len(bench.events("fed")) == fed, "so the chip resets"
        assert bench.process.poll() is None, "it does not end"
        board.close()


def test_a_watchdog_reset_is_told(tmp_path: Path) -> None:
    with running(tmp_path, cause=3) as bench:
        assert wait(lambda: bool(bench.events("fed")))
        board = MosfetBoard(bench.port, 8, WallClock())
        board.read_states()
        assert board._tripped == "W"
        board.close()


def test_the_service_pin_keeps_it_from_starting(tmp_path: Path) -> None:
    with running(tmp_path, service=0) as bench:
        assert bench.process.wait(5) == 0
        assert [bench.level(pin) for pin in range(8)] == [0] * 8
        assert bench.events("watchdog") == []


@pytest.mark.parametrize("path", sorted(FIRMWARE.glob("[!_]*.py")), ids=lambda p: p.name)
def test_the_compiler_for_boards_takes_every_file(path: Path, tmp_path: Path) -> None:
    """As for the RP2040: ARMv6-M, small integers of 31 bits."""
    target = ["-march=armv6m", "-msmall-int-bits=31"]
    subprocess.run([*cross_compiler(), *target, "-o", str(tmp_path / "out.mpy"), str(path)], check=True)
