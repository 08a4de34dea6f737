"""Real-time priority for the threads that switch heat, and for emulated hardware, which waits for no program.

Each level comes before the lower ones and before all other programs. A thread without the right to it runs as
any other. What it starts later inherits it.
"""

from __future__ import annotations

import os
from contextlib import suppress

VIRTUAL_BENCH = 1
"""All else in the process of an emulated board, such as drawing pictures. Above other programs, because it
may hold Python's lock, for which the board waits; below the programs that command heat."""
COMMANDS = 2
"""ROS programs that command a guardian, and `eldir rig off`."""
GUARDIAN = 3
EMULATED_HARDWARE = 4


def request_realtime_priority(level: int) -> None:
    """Run this thread with the priority `level` (round robin), or the highest one below it that is permitted.

    The superuser is permitted all, another user those up to the limit `rtprio`.
    """
    for permitted in range(level, 0, -1):
        with suppress(OSError, AttributeError):  # the latter where the system knows no such priority
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(permitted))
            return
