"""How much of the processor other programs used during a measurement, from Linux' /proc."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

BUSY = 0.1
"""Share of the processor time of all cores above which a machine counts as busy."""
_PROC = Path("/proc")


@dataclass
class OtherPrograms:
    """What other programs used while this one measured."""

    share: float | None = None
    """Processor time of other programs as a share of that of all cores, 0 to 1; None before the end of the
    measurement, and where the system does not tell."""

    def describe(self) -> str:
        """One sentence about the machine, and what it means for the times."""
        if self.share is None:
            return (
                "This system does not tell whether other programs used the processor meanwhile: compare "
                "times only if the machine was idle."
            )
        used = f"Other programs used {100 * self.share:.0f} % of the processor meanwhile"
        if self.share < BUSY:
            return f"{used}: the machine was quiet."
        return (
            f"{used}: the machine was busy. Times are too long, by the clock more than of the processor, and "
            "ratios are less certain; measure again on a quiet machine."
        )


@contextmanager
def watch_other_programs(proc: Path = _PROC) -> Iterator[OtherPrograms]:
    """Measures what other programs use inside the context; the result is complete after it.

    Processor time of this process, of its children and of theirs is its own. `proc` is the folder of the
    kernel's process files.
    """
    found = OtherPrograms()
    before = _read_times(proc)
    yield found
    after = _read_times(proc)
    if before is None or after is None:
        return
    everything, busy, own = (b - a for a, b in zip(before, after, strict=True))
    if everything > 0:
        found.share = round(min(max(busy - own, 0.0) / everything, 1.0), 3)


def _read_times(proc: Path) -> tuple[float, float, float] | None:
    """Seconds since the start of the machine: of all cores, of these not idle, and of this process and its
    descendants; None where there are no such files."""
    try:
        head = (proc / "stat").read_text().split("\n", 1)[0].split()
        # proc(5): user, nice, system, idle, iowait, irq, softirq, steal; time of guests is part of user.
        ticks = [int(word) for word in head[1:9]]
        own = _own_ticks(proc, os.getpid())
        second = os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, AttributeError):
        return None
    everything, idle = sum(ticks), sum(ticks[3:5])
    return everything / second, (everything - idle) / second, own / second


def _own_ticks(proc: Path, process: int) -> int:
    """Ticks of a process, of its children that have ended, and of its living descendants likewise."""
    parents, ticks = {}, {}
    for stat in proc.glob("[0-9]*/stat"):
        try:  # the name of a program may hold spaces and brackets
            fields = stat.read_text().rsplit(")", 1)[1].split()
        except (OSError, IndexError):  # it has ended meanwhile
            continue
        number = int(stat.parent.name)
        parents[number] = int(fields[1])
        ticks[number] = sum(int(word) for word in fields[11:15])
    own = {process}
    while found := {child for child, parent in parents.items() if parent in own} - own:
        own |= found
    return sum(ticks.get(number, 0) for number in own)
