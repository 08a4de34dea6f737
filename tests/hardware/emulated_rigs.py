"""Emulated boards on pseudo-terminals, rig files for them, and programs that heat them."""

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from eldir.core.yaml_files import parse_yaml
from eldir_app.commands.rig import rig as command
from eldir_hardware.clock import WallClock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.rig.devices import get_emulator
from tests.forked_programs import Forked
from tests.hardware.rigs_and_schedules import rig_text

HEAT = """
import sys, time
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.rig.configuration import Rig
with Guardian(Rig.load(sys.argv[1])) as bank, bank.armed():
    bank.heat(time.monotonic() + 0.3, {1: 5.0, 3: 5.0})
    print(bank.process, flush=True)
    bank.wait_until(time.monotonic() + 20)
"""


@contextmanager
def emulated(kind: str, channels: int = 4) -> Iterator[EmulatedBoard]:
    """An emulated board on a pseudo-terminal."""
    board = get_emulator(kind)(channels, WallClock())
    board.start()
    try:
        yield board
    finally:
        board.close()


@contextmanager
def heating_program(
    board: EmulatedBoard,
    rig: Path,
    before: str = "",
    *,
    child_guardian: bool = False,
    server: Sequence[str] = (),
) -> Iterator[tuple[Forked, int]]:
    """A program that heats channels 1 and 3 through a guardian; and the number of the guardian's process.

    `before`: code that it runs first; `child_guardian` and `server` as of `Forked`.
    """
    words = [sys.executable, "-c", before + HEAT, str(rig)]
    with Forked(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, child_guardian=child_guardian, server=server
    ) as program:
        guardian = int(program.stdout.readline())
        try:
            assert wait(lambda: board.contacts[:4] == (True, False, True, False)), program.stderr.read()
            yield program, guardian
        finally:
            program.kill()


def rig_file(path: Path, kind: str, port: str, **changes: object) -> Path:
    """A complete rig of kind real on that port."""
    path.write_text(yaml.dump(rig_values(kind, port, **changes), Dumper=yaml.CSafeDumper))
    return path


def rig_values(kind: str, port: str, **changes: object) -> dict[str, object]:
    """What its file says."""
    values = _template(kind)
    return values | {"kind": "real", "board": values["board"] | {"port": port}} | changes


@cache
def _template(kind: str) -> dict:
    values = parse_yaml(rig_text(board=kind).encode(), "the template")
    return {name: entry for name, entry in values.items() if name not in ("camera", "virtual")}


def each_once(many: Sequence[object], few: Sequence[object]) -> list:
    """All pairs. Those with which each of the first has one of the second, in turn, and the first of them has
    all, are enough for every change; the others are stress tests."""
    return [
        pytest.param(one, other, marks=[] if i == 0 or j == i % len(few) else pytest.mark.stress)
        for i, one in enumerate(many)
        for j, other in enumerate(few)
    ]


def in_turn(many: Sequence[object], few: Sequence[object]) -> list:
    """All pairs. Each of the first has one of the second, in turn; the others are stress tests."""
    return [
        pytest.param(one, other, marks=[] if j == i % len(few) else pytest.mark.stress)
        for i, one in enumerate(many)
        for j, other in enumerate(few)
    ]


def wait(condition, seconds: float = 15.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.005)
    return condition()


def run(*arguments: object):
    return CliRunner().invoke(command, [str(a) for a in arguments])
