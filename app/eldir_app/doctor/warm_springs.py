"""Warms one spring after the other, so that a person can see which channel heats which spring.

`show_wiring` is `eldir rig doctor --wiring`.
Through the bank that every run heats by: the guardian holds all its limits here too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from eldir.built.heat import HeatModel
from eldir.design import Design
from eldir.errors import EldirError
from eldir.morphology import Morphology
from eldir.parameters.wiring import Connection, for_motors
from eldir_hardware.clock import Clock
from eldir_hardware.guardian.bank import LEAD, HeaterBank, Report
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError, worst_springs
from eldir_hardware.run.drive import robot_file
from eldir_hardware.run.opened_rig import bank_of
from eldir_hardware.safety import limits
from eldir_hardware.safety.stop_signals import Stop, signals_as_errors

WARM = 48.0
"""Even the hottest spring of the tolerances stays below [C]: a surface that may be touched for ten minutes
(ISO 13732-1, table 1)."""
PAUSE = 4.0
"""Time between two pulses, in which to look and to touch [s]."""
_ROUND = 0.1  # boards time pulses in such steps [s]
_SHORTEST = 0.5  # a shorter one could pass between two read-backs [s]
_ENDS = ("rear end", "middle", "front end")
_HEIGHTS = ("low", "half-way up", "high")


def warming_pulse(rig: Rig) -> float:
    """How long each channel heats [s]: as long as the rig allows without a spring above `WARM` in the worst
    corner of its tolerances. Raises `LimitError` where the rig must not heat."""
    limits.check_rig(rig)
    longest = limits.longest_pulse(rig)
    steps = int(longest / _ROUND + 1e-6)
    hot = HeatModel([worst_springs(rig)]).run(np.ones((steps, 1)), _ROUND).temperature[:, 0]
    # A board's own timer may open a step later, as limits.STEP says.
    good = np.flatnonzero(hot <= WARM)
    length = round((len(good) - 1) * _ROUND, 3)
    if length < _SHORTEST:
        raise LimitError(
            "no pulse is short enough to warm springs that a person may touch",
            code="limit.warm-hands",
            expected=f"at most {WARM:g} C",
            found=f"{hot[min(len(hot) - 1, round(_SHORTEST / _ROUND))]:.0f} C after {_SHORTEST:g} s",
            remedy="lower supply.current_limit_a",
        )
    return length


def place_of(connection: Connection, body: Morphology | None) -> str:
    """Which spring it is, in words: motor, face, and where on the robot if that is known."""
    words = f"spring {connection.spring} on the {connection.face} face"
    if body is None:
        return words
    ends = body.springs[np.flatnonzero(body.active)[connection.spring]]
    low, size = body.positions.min(axis=0), np.ptp(body.positions, axis=0)
    third = np.clip(3 * (body.positions[ends].mean(axis=0) - low) / size, 0, 2).astype(int)
    return f"{words}, between masses {ends[0]} and {ends[1]} ({_ENDS[third[0]]}, {_HEIGHTS[third[1]]})"


def show_wiring(rig: Rig, rig_file: Path, design: Path | None, say: Callable[[str], None]) -> None:
    """Warm one spring after the other, and say which one it must be.

    `design`: file of the robot, instead of the one that the rig file names; without any, all channels of the
    rig file are heated and places are not told.
    """
    path = robot_file(rig, rig_file, design)
    body = None if path is None else Design.load(path).morphology
    connections = for_motors(rig.channels, rig.motors if body is None else body.motors)
    length = warming_pulse(rig)
    say(
        f"each channel heats for {length:g} s, to less than {WARM:g} C, and rests for {PAUSE:g} s; "
        "Ctrl-C opens all contacts at once"
    )

    def tell(connection: Connection) -> None:
        say(f"channel {connection.channel}: {place_of(connection, body)} must grow warm")

    def tell_rest(seconds: float) -> None:
        say(f"the springs rest from the run before, for {seconds:.0f} s")

    with signals_as_errors(), bank_of(rig) as opened:
        warm_each(opened.bank, opened.clock, connections, length, tell, rest=tell_rest)
    say(f"all contacts are open. If another spring grew warm, correct `channels` in {rig_file} or the wires")


def warm_each(
    bank: HeaterBank,
    clock: Clock,
    connections: Sequence[Connection],
    length: float,
    tell: Callable[[Connection], None],
    pause: float = PAUSE,
    rest: Callable[[float], None] = lambda seconds: None,
) -> None:
    """Heat one channel after the other for `length` [s], and rest for `pause` [s] after each.

    Springs that are still warm rest first; `rest` is called with the time for that [s]. `tell` is called as
    soon as a contact is reported closed. Ctrl-C and every error open all contacts at once. Raises
    `EldirError` for a contact that is never reported closed.
    """
    stop = Stop()
    with stop.caught(), bank.armed(), stop.heeded():
        if (seconds := bank.rested_at - clock.now()) > 0:
            rest(seconds)
            bank.wait_until(bank.rested_at, lambda report: None)
        for connection in connections:
            closed: list[Connection] = []

            def see(report: Report, wanted: Connection = connection, seen: list[Connection] = closed) -> None:
                if report.closed[wanted.channel - 1] and not seen:
                    seen.append(wanted)
                    tell(wanted)

            begin = clock.now() + LEAD + _ROUND
            bank.heat(begin, {connection.channel: length})
            bank.wait_until(begin + length + pause, see)
            if not closed:
                raise EldirError(
                    f"channel {connection.channel} was not reported closed",
                    code="doctor.not-closed",
                    expected=f"closed for {length:g} s",
                    remedy="check the board: eldir rig doctor",
                )
