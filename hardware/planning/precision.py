"""How exactly a board can play a schedule: what its protocol leaves, beside this computer's own delays."""

from __future__ import annotations

from collections import Counter

from hardware.rig.boards import driver_of
from hardware.rig.configuration import Rig
from hardware.schedule import ActuationSchedule

HEAT = 0.02
"""Of a pulse's heat it may be off by so much."""
EDGE = 0.020
"""A contact moves within so much of its instant [s]."""
_DELAYS = 0.005  # of this computer between a pulse's two edges, at the 99th percentile [s]


def remark(schedule: ActuationSchedule, rig: Rig) -> str:
    """What of `HEAT` and `EDGE` this board cannot keep on this schedule; empty if nothing."""
    board = driver_of(rig.board.kind)
    at_once = Counter(e.t_s for e in schedule.events if e.on)
    # The middle of those that close one after another is on time; they open at once.
    apart = (max(at_once.values()) - 1) / 2 * board.closing_apart
    length = min(p.length for p in schedule.pulses())
    off = (_DELAYS + apart) / length
    said = []
    if off > HEAT:
        said.append(
            f"pulses of {length:g} s get their heat within {100 * off:.0f} % only; "
            f"{100 * HEAT:g} % need {(_DELAYS + apart) / HEAT:.2g} s"
        )
    if apart > EDGE:
        said.append(
            f"contacts close up to {1e3 * apart:.0f} ms off their instant, {max(at_once.values())} at once"
        )
    return f"on a board of kind {rig.board.kind}, " + "; ".join(said) if said else ""
