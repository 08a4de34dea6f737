"""When contacts move on the wall clock: a real guardian, and an emulated board in a process of its own."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldir.core.records import FloatArray
from eldir_hardware.clock import WallClock
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.run.player import Player
from tests.hardware.rigs_and_schedules import gait, rig_with

PULSE = 0.5
"""Of every pulse that is played [s]."""
_EMULATE = "from eldir_app.commands.rig import rig; rig()"


class EdgeTimes(NamedTuple):
    """What the emulated board's trace tells."""

    late: FloatArray
    """Of every contact's edge behind its instant [s]."""
    heat: FloatArray
    """Length of every pulse over the one that was asked."""

    def __str__(self) -> str:
        late, (half, most), off = (
            1e3 * self.late,
            1e3 * np.quantile(abs(self.late), [0.5, 0.99]),
            self.heat - 1,
        )
        return (
            f"{len(late)} edges, off by 50 % {half:.1f}, 99 % {most:.1f}, at most {abs(late).max():.1f} ms "
            f"(mean {late.mean():+.1f}); heat of {PULSE:g} s off by 99 % "
            f"{100 * np.quantile(abs(off), 0.99):.2f}, at most {100 * abs(off).max():.2f} %; "
            f"load {os.getloadavg()[0]:.1f}"
        )


def measure(kind: str, cycles: int = 14) -> EdgeTimes:
    """Play two springs of two faces, `cycles` times two seconds.

    The board runs in real time where that is permitted: a real one does not wait for this computer.
    """
    rig = rig_with(limits={"min_off_s": 0.3}, board={"kind": kind, "retriggerable": True})
    schedule = compile_schedule(gait(duty=(0.25, 0.25), period=2.0, phase=(0.0, 0.4)), rig, cycles=cycles)
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "edges.jsonl"
        command = [sys.executable, "-c", _EMULATE, "emulate", "--board", kind, "--trace", str(trace)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as board:
            port = board.stdout.readline().strip()
            with suppress(PermissionError):
                for thread in os.listdir(f"/proc/{board.pid}/task"):
                    os.sched_setscheduler(int(thread), os.SCHED_RR, os.sched_param(10))
            with Guardian(rig, port) as bank:
                start = time.monotonic() + 1.0
                Player(bank, schedule, rig, WallClock()).play(start)
            board.send_signal(signal.SIGTERM)
        edges = [json.loads(line) for line in trace.read_text().splitlines()]
    wanted = sorted((c, t, on) for t, changes in schedule.switchings() for c, on in changes.items())
    found = sorted((e["channel"], e["t_s"] - start, e["closed"]) for e in edges)
    late = np.array([f[1] - w[1] for f, w in zip(found, wanted, strict=True)])
    lengths = np.array([b[1] - a[1] for a, b in zip(found[::2], found[1::2], strict=True)])
    return EdgeTimes(late, lengths / PULSE)


if __name__ == "__main__":
    for name in sys.argv[2:]:
        print(name, measure(name, int(sys.argv[1])), flush=True)
