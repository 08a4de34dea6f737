"""Logs of a killed recorder, cut and damaged."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.log.recover import recover_log
from tests.hardware.log.log_contents import EPOCH, NAMES, POSITIONS, picture

KILLED = """
import sys, time
import numpy as np
from eldir_hardware.log.background import BackgroundRecorder
from eldir_hardware.log.recorder import Recorder
with BackgroundRecorder(Recorder(sys.argv[1], epoch_ns=int(sys.argv[2]))) as log:
    log.attach("design.json", b"{}")
    start = time.monotonic()
    print("ready", flush=True)
    while True:
        t = time.monotonic() - start
        log.on_tracks(t, ("m1",), np.array([[t, 0.0]]))
        log.on_frame(t, np.zeros((48, 64, 3), np.uint8))
        print(t, flush=True)
        time.sleep(0.01)
"""


def record(path: Path, seconds: float = 12.0) -> Path:
    """Long enough for many chunks and for the second reminder of what the channels are."""
    rng = np.random.default_rng(1)
    with Recorder(path, channels=("front",), springs=("s4",), epoch_ns=EPOCH) as log:
        log.attach("design.json", b'{"format": "eldir-design/1"}')
        log.attach("rig.yaml", b"format: eldir-rig/1\n" * 20)
        for i in range(round(10 * seconds)):
            log.on_frame(0.1 * i, picture(i % 10))
            log.on_tracks(0.1 * i, NAMES, POSITIONS + rng.normal(0, 0.01))
            if i % 5 == 0:
                log.on_relays(0.1 * i, (i % 10 == 0,))
                log.on_temperatures(0.1 * i, (20.0 + i,))
    return path


def messages(path: Path) -> set[tuple[str, int, bytes]]:
    with path.open("rb") as file:
        return {(c.topic, m.log_time, m.data) for _, c, m in make_reader(file).iter_messages()}


def kill_and_recover(folder: Path, instants: list[float]) -> None:
    """Kill recording programs at these instants after their start [s]; at most a second may be missing."""
    folder.mkdir()
    logs = [folder / str(i) / "log.mcap" for i in range(len(instants))]
    command = [sys.executable, "-c", KILLED]
    running = []
    for log in logs:
        child = subprocess.Popen([*command, log, str(EPOCH)], stdout=subprocess.PIPE, text=True)
        assert child.stdout is not None and child.stdout.readline() == "ready\n"
        running.append((child, time.monotonic()))
    for (child, start), instant in sorted(zip(running, instants, strict=True), key=lambda x: x[0][1] + x[1]):
        time.sleep(max(start + instant - time.monotonic(), 0))
        child.send_signal(signal.SIGKILL)
    for (child, _), log in zip(running, logs, strict=True):
        said = child.communicate()[0].splitlines(keepends=True)
        times = np.array([float(line) for line in said if line.endswith("\n")])
        out = log.with_name("out") / "log.mcap"
        recover_log(log, out)
        tracks = read_log(out).tracks
        kept = np.zeros(0) if tracks is None else tracks.times
        np.testing.assert_allclose(kept, times[: len(kept)], atol=1e-8)  # no gaps
        assert times[-1] - max(kept, default=0.0) < 1.0
        assert read_log(out).attachments == {"design.json": b"{}"}
