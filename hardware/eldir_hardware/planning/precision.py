"""How exactly a relay board can play a schedule, from the delays of its protocol and of this computer."""

from __future__ import annotations

from collections import Counter

from eldir_hardware.rig.boards import driver_of
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule

HEAT = 0.02
"""Allowed relative error of the heat of a pulse."""
EDGE = 0.020
"""Allowed error of the instant at which a contact switches [s]."""
_DELAYS = 0.005  # of this computer between a pulse's two edges, at the 99th percentile [s]


def remark(schedule: ActuationSchedule, rig: Rig) -> str:
    """A sentence on which of `HEAT` and `EDGE` this board exceeds with this schedule; empty if none."""
    if not schedule.events:
        return ""
    board = driver_of(rig.board.kind)
    at_once = Counter(e.t_s for e in schedule.events if e.on)
    # The middle of those that close one after another is on time; they open at once.
    apart = (max(at_once.values()) - 1) / 2 * board.closing_apart
    length = min(p.length for p in schedule.pulses())
    off = (_DELAYS + apart) / length
    said = []
    if off > HEAT:
        said.append(
            f"the heat of pulses of {length:g} s is exact to {100 * off:.0f} % only; "
            f"{100 * HEAT:g} % need pulses of {(_DELAYS + apart) / HEAT:.2g} s"
        )
    if apart > EDGE:
        said.append(
            f"contacts close up to {1e3 * apart:.0f} ms before or after their time, because "
            f"{max(at_once.values())} are due at once"
        )
    return f"on a board of kind {rig.board.kind}, " + "; ".join(said) if said else ""
