"""Faults that strike a run of `eldir rig drive`: of its board, its programs, its link, its log."""

import math
import os
import random
import resource
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_driver
from eldir_hardware.rig.port_holder import find_holder
from eldir_hardware.schedule import ActuationSchedule
from tests.forked_programs import Forked
from tests.hardware.relay.held_serial_output import HeldUart

# A program that inherits an ignored SIGHUP, as under nohup, goes on when its terminal closes.
_ON_A_TERMINAL = "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL)"
ELDIR = [sys.executable, "-c", f"{_ON_A_TERMINAL}; from eldir_app.main import main; main()"]
PERIOD, CYCLES = 3.0, 2
LIMITS = {
    "limits": {"min_off_s": 0.3, "max_on_s": 1.2},
    "cutoff": {"kind": "timer", "max_on_s": 1.5},
}
STUCK = "did not switch.*cut the heating supply now"
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
    player: Forked
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


def guardian_of(board: EmulatedBoard) -> int | None:
    """The process that holds the board's port."""
    holder = find_holder(board.port)
    return holder and holder.process


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
    if get_driver(Rig.load(bench.rig).board.kind).times_pulses:
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
    termios.tcflow(bench.board.client_end, termios.TCOOFF)
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
