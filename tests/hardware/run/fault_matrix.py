"""Faults that strike a real run at random instants, judged only by the emulated board's trace of its edges.

`eldir rig drive` runs in a process of its own, with its guardian; the board is behind a pseudo-terminal.
"""

import math
import os
import random
import re
import signal
import subprocess
import threading
import time
from contextlib import suppress
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path
from typing import IO, NamedTuple
from unittest.mock import patch

from eldir_hardware.clock import WallClock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_driver, get_emulator
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.safety.latch import read_records
from eldir_hardware.schedule import ActuationSchedule
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import rig_file, rig_values, wait
from tests.hardware.relay.held_serial_output import HeldUart
from tests.hardware.rigs_and_schedules import gait
from tests.hardware.run.faults import (
    CYCLES,
    ELDIR,
    FAULTS,
    LIMITS,
    LINK_FAULTS,
    PERIOD,
    Bench,
    guardian_of,
)


class Outcome(NamedTuple):
    kind: str
    fault: str
    at: float
    """Instant of the fault after the schedule's start [s]."""
    off_after: float
    """From the fault to the last opening of a contact that can open [s]."""
    closed: tuple[int, ...]
    """Contacts that can open and were still closed at the end."""
    latched: bool
    lines: tuple[tuple[float, str], ...]
    """What was printed on stderr, with the time since the fault [s]."""
    status: int
    second: bool = False
    """Whether the second board was switched."""

    def __str__(self) -> str:
        told = "; ".join(f"{line[:90]} ({t:.2f} s)" for t, line in self.lines[-2:])
        return f"| {self.kind} | {self.fault} | {self.at:.2f} s | {self.off_after:.2f} s | {told} |"

    @property
    def told_after(self) -> float:
        """When the line that the person must read was printed [s]; infinite if it was not."""
        text = "\n".join(line for _, line in self.lines)
        found = re.search(FAULTS[self.fault].says, text, re.DOTALL)
        return math.inf if found is None else self.lines[text[: found.start()].count("\n")][0]

    @property
    def wrong(self) -> str:
        """What must not be, or nothing."""
        fault = FAULTS[self.fault]
        opens = get_driver(self.kind).times_pulses or not fault.unreachable
        if self.closed and opens:
            return f"channels {self.closed} stayed closed"
        if self.off_after > fault.within and opens:
            return f"off after {self.off_after:.2f} s, not {fault.within:g}"
        if fault.latches and not self.latched:
            return "the next start is allowed"
        if fault.says and self.told_after > fault.says_within:
            return f"told after {self.told_after:.2f} s, not {fault.says_within:g}: {fault.says}"
        return "the second board was switched" if self.second else ""


class NeverHeatedError(Exception):
    """The run ended before the fault."""


def drawn(count: int, seed: int) -> list[tuple[str, str, int]]:
    """Kind of board, fault and seed of so many strikes: every pair once in random order, then again."""
    rng = random.Random(seed)
    pairs = [(kind, fault) for kind in installed_kinds() for fault in FAULTS]
    rounds = (rng.sample(pairs, len(pairs)) for _ in range(math.ceil(count / len(pairs))))
    return [(*pair, rng.randrange(1 << 30)) for pair in chain.from_iterable(rounds)][:count]


def strike(folder: Path, kind: str, fault: str, seed: int, cycles: int = CYCLES) -> Outcome:
    """One run with one fault; again where a machine that is too busy ended the run before the fault.

    Raises:
        NeverHeatedError: four runs ended before the fault.
    """
    for attempt in range(4):
        place = folder / f"{kind}-{fault.replace(',', '').replace(' ', '-')}-{seed}-{attempt}"
        place.mkdir()
        own_records = {"XDG_STATE_HOME": str(place / "state")}  # of boards that have gone, none is left
        with suppress(NeverHeatedError), patch.dict(os.environ, own_records):
            return _strike(place, kind, fault, random.Random(seed + attempt), cycles)
    raise NeverHeatedError(f"{kind}, {fault}: heating never began")


@cache
def _schedule(kind: str, cycles: int) -> ActuationSchedule:
    """The same for every port."""
    rig = Rig.from_json(rig_values(kind, "/dev/ttyUSB0", **LIMITS))
    compiled = compile_schedule(
        gait(phase=(0.0, 0.25), duty=(1 / 3, 1 / 3), period=PERIOD), rig, (0, 1), cycles
    )
    return replace(compiled, settle_s=0.0, conditioning_cycles=0)


def prepared(
    folder: Path, kind: str, linked: bool = False, cycles: int = CYCLES
) -> tuple[EmulatedBoard, Path, ActuationSchedule, list[str]]:
    """An emulated board, a rig on it (by way of the link `board` if `linked`), a schedule, and the words that
    drive it. The record of a linked board stays when its port has gone."""
    board = get_emulator(kind)(4, WallClock())
    link = folder / "board"
    link.symlink_to(board.start())
    rig = rig_file(folder / "rig.yaml", kind, str(link) if linked else board.port, **LIMITS)
    schedule = _schedule(kind, cycles)
    with_digests(schedule, Rig.load(rig)).save(folder / "schedule.json")
    files = [str(folder / "schedule.json"), "--rig", str(rig), "--log", str(folder / "log.mcap")]
    return board, rig, schedule, [*ELDIR, "rig", "drive", *files]


def held(words: list[str], uart: HeldUart) -> list[str]:
    """The program whose output is held up."""
    python, option, code, *others = words
    return [python, option, uart.code + code, *others]


def _strike(folder: Path, kind: str, name: str, rng: random.Random, cycles: int) -> Outcome:
    fault = FAULTS[name]
    board, rig, schedule, words = prepared(folder, kind, name in LINK_FAULTS, cycles)
    second = get_emulator(kind)(4, WallClock())
    second.start()
    with (
        HeldUart(board.port) as uart,
        Forked(
            held(words, uart) if fault.unreachable else words,
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            child_guardian=fault.unreachable,  # what is held up is written by the program and its children
        ) as player,
    ):
        others: list[subprocess.Popen] = []
        guardian = None
        printed: list[tuple[float, str]] = []
        readers = [_read(player.stderr, printed)]
        try:
            wait(lambda: bool(board.contact_events) or player.poll() is not None, 25.0)
            guardian = guardian_of(board)
            if not board.contact_events or guardian is None:
                raise NeverHeatedError
            began = min(e.t for e in board.contact_events)
            bench = Bench(
                board, player, guardian, rig, schedule, began, others, uart, folder / "board", second
            )
            _rest_until(began + rng.uniform(0.0, schedule.duration - 1.5), player)
            if fault.while_closed:
                wait(lambda: any(board.contacts) or player.poll() is not None, 5.0)
            if player.poll() is not None:
                raise NeverHeatedError
            at = time.monotonic() - began
            struck = fault.strike(bench, rng)
            readers += [_read(other.stdout, printed) for other in others if other.stdout is not None]
            _end(bench, struck + fault.within)
            latched = _latched(board)
        finally:
            player.kill()
            for other in others:
                other.kill()
                other.wait()
            if guardian is not None and guardian in _alive(guardian):
                os.kill(guardian, signal.SIGKILL)
            for reader in readers:
                reader.join(10.0)
            for other in others:
                other.stdout.close()
            second.close()
            board.close()
    can_open = [c for c in range(1, 5) if c not in board.faults.welded]
    opened = [e.t - struck for e in board.contact_events if e.channel in can_open and not e.closed]
    still = tuple(c for c in can_open if board.contacts[c - 1])
    lines = tuple(sorted((t - struck, line) for t, line in printed))
    off_after = max([0.0, *opened])
    return Outcome(
        kind, name, at, off_after, still, latched, lines, player.returncode, bool(second.contact_events)
    )


def _read(stream: IO[str] | None, printed: list[tuple[float, str]]) -> threading.Thread:
    """Add each line that a program prints, with its time, until it closes the stream."""
    assert stream is not None

    def read() -> None:
        printed.extend((time.monotonic(), line.strip()) for line in stream)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    return thread


def _rest_until(t: float, player: Forked) -> None:
    wait(lambda: time.monotonic() >= t or player.poll() is not None, max(t - time.monotonic(), 0.0))


def _alive(guardian: int) -> list[int]:
    """The process, if it still is this guardian."""
    with suppress(FileNotFoundError):
        if b"guardian" in Path(f"/proc/{guardian}/cmdline").read_bytes():
            return [guardian]
    return []


def _end(bench: Bench, limit: float) -> None:
    """Wait for the end of the programs, those that hang being killed late enough."""
    wait(lambda: time.monotonic() > limit + 0.5, 20.0)
    stopped = _is_stopped(bench.player.pid)
    if stopped:
        bench.player.kill()
    killer = threading.Timer(20.0, bench.player.kill)
    killer.start()
    bench.player.wait()
    killer.cancel()
    for other in bench.others:
        with suppress(subprocess.TimeoutExpired):
            other.wait(12)
    wait(lambda: not _alive(bench.guardian) or _is_stopped(bench.guardian), 10.0)


def _is_stopped(process: int) -> bool:
    with suppress(FileNotFoundError, ProcessLookupError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "T"
    return False


def _latched(board: EmulatedBoard) -> bool:
    """Whether a record stops this board; the number of a port that is gone may belong to another by now."""
    return any(record.identity.name == board.port for record in read_records()[0].values())
