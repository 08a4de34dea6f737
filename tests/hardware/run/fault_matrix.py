"""Faults that strike a real run at random instants, judged only by the emulated board's trace of its edges.

`eldir rig drive` runs in a process of its own, with its guardian; the board is behind a pseudo-terminal.
"""

import math
import os
import random
import re
import resource
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, cycle
from pathlib import Path
from typing import IO, NamedTuple
from unittest.mock import patch

from hardware.clock import WallClock
from hardware.emulator.board import EmulatedBoard
from hardware.planning.compiler import compile_schedule
from hardware.relay.registration import kinds
from hardware.rig.boards import driver_of, emulator_of
from hardware.rig.configuration import Rig
from hardware.safety.latch import read_records
from hardware.safety.schedule_digests import sealed
from hardware.schedule import ActuationSchedule
from tests.hardware.emulated_rigs import rig_file, wait
from tests.hardware.relay.held_serial_output import HeldUart
from tests.hardware.rigs_and_schedules import gait

# A program that inherits an ignored SIGHUP, as under nohup, goes on when its terminal closes.
_ON_A_TERMINAL = "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL)"
ELDIR = [sys.executable, "-c", f"{_ON_A_TERMINAL}; from eldir.commands.main import main; main()"]
PERIOD, CYCLES = 3.0, 2
STUCK = "does not follow.*cut the heating supply now"
"""What a person must read first where a contact is stuck, as a pattern."""
TOLD = 3.0
"""They can read it after this time [s]."""
SAID = 4.0
"""The same, where no command reaches the board any more [s]."""
LIVES, DEAD = 0.5, 1.0
"""Everything is off after this time [s]: where both programs live, and where one is dead or hangs."""
_THIEF = """
import os, sys, time
handle = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
end = time.monotonic() + 5
while time.monotonic() < end:
    try:
        if os.read(handle, 4096):
            print(time.monotonic(), flush=True)
    except BlockingIOError:
        pass
"""


@dataclass
class Bench:
    """A run that heats."""

    board: EmulatedBoard
    player: subprocess.Popen
    guardian: int
    rig: Path
    schedule: ActuationSchedule
    began: float
    """First instant of the schedule [s, monotonic]."""
    others: list[subprocess.Popen]
    uart: HeldUart
    link: Path
    """What the rig file names: a link to the board's port."""
    second: EmulatedBoard
    """A second board of the same kind, to which the link may be moved."""

    def next_switching(self, channel: int, now: float) -> float:
        """When the schedule switches a channel next [s, monotonic]; infinite if it does not."""
        instants = (self.began + t for t, changes in self.schedule.switchings() if channel in changes)
        return min((t for t in instants if t > now + 0.05), default=math.inf)

    @property
    def last_opening(self) -> float:
        """When the last contact opens by the schedule [s, monotonic]."""
        return self.began + max(t for t, _ in self.schedule.switchings())


Strike = Callable[[Bench, random.Random], float]
"""Strikes, and returns the instant from which the time until everything is off counts."""


class Fault(NamedTuple):
    strike: Strike
    within: float
    latches: bool = True
    while_closed: bool = False
    """Whether it can be noticed only while a contact is closed."""
    says: str = ""
    """Pattern of what the person must read."""
    says_within: float = math.inf
    """Time until its line is printed [s]."""
    unreachable: bool = False
    """Whether no command can reach the board: its own timer or the cut-off opens, and a person must know."""


def children(process: int) -> list[int]:
    with suppress(FileNotFoundError):
        return [int(n) for n in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
    return []


def guardian_of(player: int) -> int | None:
    """The guardian among the player's children, by what it runs."""
    for child in children(player):
        with suppress(FileNotFoundError):
            if b"guardian" in Path(f"/proc/{child}/cmdline").read_bytes():
                return child
    return None


def of_board(change: Callable[[EmulatedBoard], None]) -> Strike:
    def strike(bench: Bench, rng: random.Random) -> float:
        change(bench.board)
        return time.monotonic()

    return strike


def signals(*targets: tuple[str, int]) -> Strike:
    """Signals to player or guardian, one after the other."""

    def strike(bench: Bench, rng: random.Random) -> float:
        now = time.monotonic()
        for who, number in targets:
            os.kill(bench.player.pid if who == "player" else bench.guardian, number)
        return now

    return strike


def off_command(bench: Bench) -> float:
    """`eldir rig off` from another terminal, counted from its start."""
    now = time.monotonic()
    bench.others.append(
        subprocess.Popen([*ELDIR, "rig", "off", "--rig", str(bench.rig)], stdout=subprocess.PIPE, text=True)
    )
    return now


def then_off(*targets: tuple[str, int]) -> Strike:
    def strike(bench: Bench, rng: random.Random) -> float:
        signals(*targets)(bench, rng)
        return off_command(bench)

    return strike


def by_link(moved: bool, then: Strike) -> Strike:
    """The link is moved to the second board, or removed; then another fault strikes."""

    def strike(bench: Bench, rng: random.Random) -> float:
        bench.link.unlink()
        if moved:
            bench.link.symlink_to(bench.second.port)
        return then(bench, rng)

    return strike


def both_killed(bench: Bench, rng: random.Random) -> float:
    """Without a timer on the board, only a person or the cut-off opens the contacts then."""
    killed = signals(("player", signal.SIGKILL), ("guardian", signal.SIGKILL))(bench, rng)
    if driver_of(Rig.load(bench.rig).board.kind).times_pulses:
        return killed
    time.sleep(0.3)
    return off_command(bench)


def asleep(bench: Bench, rng: random.Random) -> float:
    """Both programs stand still, as while the computer sleeps; counted from when they run again."""
    for number in (bench.player.pid, bench.guardian):
        os.kill(number, signal.SIGSTOP)
    time.sleep(0.8)
    for number in (bench.guardian, bench.player.pid):
        os.kill(number, signal.SIGCONT)
    return time.monotonic()


def full_disk(bench: Bench, rng: random.Random) -> float:
    now = time.monotonic()
    for number in (bench.player.pid, bench.guardian):
        resource.prlimit(number, resource.RLIMIT_FSIZE, (1, 1))
    return now


def stuck(bench: Bench, rng: random.Random) -> float:
    """A contact stays as it is, and the board reports it; counted from its next switching."""
    now = time.monotonic()
    channel = rng.choice([c for c in range(1, 5) if bench.next_switching(c, now) < math.inf])
    bench.board.faults.welded.add(channel)
    bench.board.faults.deaf.add(channel)
    return bench.next_switching(channel, now)


def welded(bench: Bench, rng: random.Random) -> float:
    """The board does not know: the others go on as scheduled."""
    bench.board.faults.welded.add(rng.randrange(1, 5))
    return bench.last_opening


def stolen(bench: Bench, rng: random.Random) -> float:
    """Another program takes what comes from the board; counted from the first bytes that it took."""
    thief = subprocess.Popen(
        [sys.executable, "-c", _THIEF, bench.board.port], stdout=subprocess.PIPE, text=True
    )
    bench.others.append(thief)
    assert thief.stdout is not None
    return float(thief.stdout.readline() or time.monotonic())


def stuck_closed(*then: Strike) -> Strike:
    """A contact that is closed stays closed, and the board reports it; then all of these strike."""

    def strike(bench: Bench, rng: random.Random) -> float:
        channel = rng.choice([c for c in range(1, 5) if bench.board.contacts[c - 1]] or [1])
        bench.board.faults.welded.add(channel)
        bench.board.faults.deaf.add(channel)
        return min(one(bench, rng) for one in then)

    return strike


def repeated(*numbers: int) -> Strike:
    """Signals to the player in turn, at one interval of 0.05 to 0.4 s, until it has ended."""

    def strike(bench: Bench, rng: random.Random) -> float:
        interval, began = rng.uniform(0.05, 0.4), time.monotonic()

        def send() -> None:
            for number in cycle(numbers):
                bench.player.send_signal(number)
                with suppress(subprocess.TimeoutExpired):
                    bench.player.wait(interval)
                    return

        threading.Thread(target=send, daemon=True).start()
        return began

    return strike


def _fault(name: str, value: object) -> Strike:
    return of_board(lambda board: setattr(board.faults, name, value))


def suspended(bench: Bench, rng: random.Random) -> float:
    """Another program stops the output of the port."""
    termios.tcflow(bench.board._guest, termios.TCOOFF)
    return time.monotonic()


def hung_drain(bench: Bench, rng: random.Random) -> float:
    """The adapter takes bytes into its queue and sends none of them."""
    bench.uart.hold(restarts=False)
    return time.monotonic()


FAULTS = {
    "unplugged": Fault(of_board(lambda board: board.unplug()), LIVES),
    "board reset": Fault(of_board(lambda board: board.reset()), LIVES, while_closed=True),
    "no answer": Fault(_fault("silent", True), LIVES),
    "answer 0.35 s late": Fault(_fault("late", 0.35), LIVES),
    "answer 0.7 s late": Fault(_fault("late", 0.7), LIVES),
    "garbled answer": Fault(_fault("garbled", True), LIVES),
    "port stolen": Fault(stolen, LIVES),
    "contact stuck, reported": Fault(stuck, LIVES),
    "contact welded, not reported": Fault(welded, LIVES, latches=False),
    "SIGINT": Fault(signals(("player", signal.SIGINT)), LIVES),
    "SIGTERM": Fault(signals(("player", signal.SIGTERM)), LIVES),
    "SIGHUP": Fault(signals(("player", signal.SIGHUP)), LIVES),
    "SIGTERM of the guardian": Fault(signals(("guardian", signal.SIGTERM)), LIVES),
    "full disk": Fault(full_disk, LIVES),
    "SIGKILL of the player": Fault(signals(("player", signal.SIGKILL)), DEAD),
    "SIGKILL of the guardian": Fault(signals(("guardian", signal.SIGKILL)), DEAD),
    "SIGKILL of both": Fault(both_killed, DEAD),
    "player hangs": Fault(signals(("player", signal.SIGSTOP)), DEAD),
    "guardian hangs": Fault(signals(("guardian", signal.SIGSTOP)), DEAD),
    "asleep for 0.8 s": Fault(asleep, LIVES, while_closed=True),
    "rig off": Fault(then_off(), LIVES),
    "rig off, player hangs": Fault(then_off(("player", signal.SIGSTOP)), DEAD),
    "rig off, guardian hangs": Fault(then_off(("guardian", signal.SIGSTOP)), DEAD),
    **{
        f"contact stuck, {name}": Fault(stuck_closed(*strikes), LIVES, True, True, says, TOLD)
        for name, strikes, says in (
            ("SIGINT repeated", [repeated(signal.SIGINT)], STUCK),
            ("SIGTERM repeated", [repeated(signal.SIGTERM)], STUCK),
            ("SIGHUP, SIGTERM in turn", [repeated(signal.SIGHUP, signal.SIGTERM)], STUCK),
            ("full disk", [full_disk], f"{STUCK}.*cannot (write|be written)"),
            ("full disk, SIGINT repeated", [full_disk, repeated(signal.SIGINT)], STUCK),
        )
    },
    "suspended output": Fault(suspended, LIVES, while_closed=True),
    "hung drain": Fault(hung_drain, DEAD, True, True, "cut the heating supply now", SAID, unreachable=True),
}
_BY_LINK = {
    "SIGINT": Fault(signals(("player", signal.SIGINT)), LIVES),
    "SIGKILL of the guardian": Fault(signals(("guardian", signal.SIGKILL)), DEAD),
    "guardian hangs": Fault(signals(("guardian", signal.SIGSTOP)), DEAD),
    "rig off": Fault(then_off(), LIVES),
    "rig off, guardian hangs": Fault(then_off(("guardian", signal.SIGSTOP)), DEAD),
    "SIGKILL of both and rig off": Fault(
        then_off(("player", signal.SIGKILL), ("guardian", signal.SIGKILL)), DEAD
    ),
}
LINK_FAULTS = {
    f"{how} link then {name}": fault._replace(
        strike=by_link(how == "moved", fault.strike),
        says="to allow heating" if "rig off" in name else "by the board's report",
    )
    for how in ("moved", "removed")
    for name, fault in _BY_LINK.items()
}
FAULTS |= LINK_FAULTS


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
        opens = driver_of(self.kind).times_pulses or not fault.unreachable
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
    pairs = [(kind, fault) for kind in kinds() for fault in FAULTS]
    rounds = (rng.sample(pairs, len(pairs)) for _ in range(math.ceil(count / len(pairs))))
    return [(*pair, rng.randrange(1 << 30)) for pair in chain.from_iterable(rounds)][:count]


def strike(folder: Path, kind: str, fault: str, seed: int) -> Outcome:
    """One run with one fault; again where a machine that is too busy ended the run before the fault.

    Raises:
        NeverHeatedError: four runs ended before the fault.
    """
    for attempt in range(4):
        place = folder / f"{kind}-{fault.replace(',', '').replace(' ', '-')}-{seed}-{attempt}"
        place.mkdir()
        own_records = {"XDG_STATE_HOME": str(place / "state")}  # of boards that have gone, none is left
        with suppress(NeverHeatedError), patch.dict(os.environ, own_records):
            return _strike(place, kind, fault, random.Random(seed + attempt))
    raise NeverHeatedError(f"{kind}, {fault}: heating never began")


def _schedule(rig: Path) -> ActuationSchedule:
    compiled = compile_schedule(
        gait(phase=(0.0, 0.25), duty=(1 / 3, 1 / 3), period=PERIOD), Rig.load(rig), (0, 1), CYCLES
    )
    return replace(compiled, settle_s=0.0, conditioning_cycles=0)


def prepared(
    folder: Path, kind: str, linked: bool = False
) -> tuple[EmulatedBoard, Path, ActuationSchedule, list[str]]:
    """An emulated board, a rig on it (by way of the link `board` if `linked`), a schedule, and the words that
    drive it. The record of a linked board stays when its port has gone."""
    board = emulator_of(kind)(4, WallClock())
    link = folder / "board"
    link.symlink_to(board.start())
    rig = rig_file(
        folder / "rig.yaml",
        kind,
        str(link) if linked else board.port,
        limits={"least_off_s": 0.3, "longest_on_s": 1.2},
        cutoff={"kind": "timer", "longest_on_s": 1.5},
    )
    schedule = _schedule(rig)
    sealed(schedule, Rig.load(rig)).save(folder / "schedule.json")
    files = [str(folder / "schedule.json"), "--rig", str(rig), "--log", str(folder / "log.mcap")]
    return board, rig, schedule, [*ELDIR, "rig", "drive", *files]


def _strike(folder: Path, kind: str, name: str, rng: random.Random) -> Outcome:
    fault = FAULTS[name]
    board, rig, schedule, words = prepared(folder, kind, name in LINK_FAULTS)
    second = emulator_of(kind)(4, WallClock())
    second.start()
    with (
        HeldUart(board.port) as uart,
        subprocess.Popen(
            [*(uart.words if fault.unreachable else []), *words],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        ) as player,
    ):
        others: list[subprocess.Popen] = []
        guardian = None
        printed: list[tuple[float, str]] = []
        readers = [_read(player.stderr, printed)]
        try:
            wait(lambda: bool(board.edges) or player.poll() is not None, 25.0)
            guardian = guardian_of(player.pid)
            if not board.edges or guardian is None:
                raise NeverHeatedError
            began = min(e.t for e in board.edges)
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
            second.close()
            board.close()
    can_open = [c for c in range(1, 5) if c not in board.faults.welded]
    opened = [e.t - struck for e in board.edges if e.channel in can_open and not e.closed]
    still = tuple(c for c in can_open if board.contacts[c - 1])
    lines = tuple(sorted((t - struck, line) for t, line in printed))
    off_after = max([0.0, *opened])
    return Outcome(kind, name, at, off_after, still, latched, lines, player.returncode, bool(second.edges))


def _read(stream: IO[str] | None, printed: list[tuple[float, str]]) -> threading.Thread:
    """Add each line that a program prints, with its time, until it closes the stream."""
    assert stream is not None

    def read() -> None:
        printed.extend((time.monotonic(), line.strip()) for line in stream)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    return thread


def _rest_until(t: float, player: subprocess.Popen) -> None:
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
