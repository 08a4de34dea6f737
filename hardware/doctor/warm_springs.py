"""Warms one spring after the other, so that a person can see which channel heats which spring.

Through the bank that every run heats by: the guardian holds all its limits here too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from eldir.built.heat import HeatModel
from eldir.errors import EldirError
from eldir.morphology import Morphology
from eldir.parameters.wiring import Connection
from hardware.clock import Clock
from hardware.guardian.bank import LEAD, Bank, Report
from hardware.rig.configuration import Rig
from hardware.rig.supply import LimitError, worst_springs
from hardware.safety import limits
from hardware.safety.stop_signals import Stop

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


def warm_each(
    bank: Bank,
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
            bank.rest_until(bank.rested_at, lambda report: None)
        for connection in connections:
            closed: list[Connection] = []

            def see(report: Report, wanted: Connection = connection, seen: list[Connection] = closed) -> None:
                if report.closed[wanted.channel - 1] and not seen:
                    seen.append(wanted)
                    tell(wanted)

            begin = clock.now() + LEAD + _ROUND
            bank.heat(begin, {connection.channel: length})
            bank.rest_until(begin + length + pause, see)
            if not closed:
                raise EldirError(
                    f"channel {connection.channel} was not reported closed",
                    code="doctor.not-closed",
                    expected=f"closed for {length:g} s",
                    remedy="check the board: eldir rig doctor",
                )
