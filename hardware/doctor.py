"""Checks of a rig that heat nothing; each finding with a remedy."""

from __future__ import annotations

import os
import shutil
import stat
import time
from pathlib import Path
from typing import NamedTuple

from eldir.errors import EldirError
from hardware.hold import held
from hardware.relay.drivers import open_board
from hardware.rig import Rig
from hardware.stuck import stuck_temperature
from hardware.supply import worst_springs

_LOG_SPACE = 1e9  # an hour of 60 frames a second takes ten times as much [bytes]


class Finding(NamedTuple):
    """One check."""

    subject: str
    ok: bool
    text: str


def examine(rig: Rig, folder: Path) -> list[Finding]:
    """All checks; `folder` is where logs will go."""
    findings = [_measured(rig), _stuck(rig), _clock(), _disk(folder)]
    if rig.kind == "real" and rig.board.port is not None:
        port = _port(rig.board.port)
        findings.append(port)
        if port.ok:
            findings.append(_board(rig))
    return findings


def _measured(rig: Rig) -> Finding:
    try:
        worst_springs(rig)
    except EldirError as error:
        return Finding("measurements", False, str(error))
    return Finding("measurements", True, f"{rig.springs.resistance_ohm} Ohm, {rig.supply.current_limit_a} A")


def _stuck(rig: Rig) -> Finding:
    try:
        hottest = stuck_temperature(rig, worst_springs(rig), None)
    except EldirError as error:
        return Finding("a welded contact", False, str(error))
    return Finding("a welded contact", True, f"a cold spring gets {hottest:.0f} C hot, below the ceiling")


def _port(port: str) -> Finding:
    try:
        mode = os.stat(port).st_mode
    except OSError as error:
        return Finding("port", False, f"{port}: {error.strerror}; look under /dev/serial/by-path")
    if not stat.S_ISCHR(mode):
        return Finding("port", False, f"{port} is no serial device; look under /dev/serial/by-path")
    if not os.access(port, os.R_OK | os.W_OK):
        return Finding("port", False, f"{port} may not be opened; join its group: usermod -aG dialout USER")
    return Finding("port", True, port)


def _board(rig: Rig) -> Finding:
    try:
        with held(str(rig.board.port)), open_board(rig) as board:
            begun = time.monotonic()
            states = board.states()
            took = time.monotonic() - begun
    except EldirError as error:
        return Finding("board", False, str(error))
    closed = [str(i) for i, state in enumerate(states, start=1) if state]
    if closed:
        return Finding("board", False, f"channels {', '.join(closed)} are closed; eldir rig off")
    return Finding("board", True, f"{rig.board.kind}, all open, answers within {1e3 * took:.0f} ms")


def _clock() -> Finding:
    resolution = time.get_clock_info("monotonic").resolution
    begun = time.monotonic()
    time.sleep(0.01)
    late = time.monotonic() - begun - 0.01
    ok = resolution <= 1e-3 and late < 0.02
    text = f"resolution {resolution:g} s, wakes {1e3 * late:.1f} ms late"
    return Finding("clock", ok, text if ok else f"{text}; close other programs")


def _disk(folder: Path) -> Finding:
    free = shutil.disk_usage(folder).free
    ok = free >= _LOG_SPACE
    return Finding("disk", ok, f"{free / 1e9:.1f} GB free" + ("" if ok else "; make room for logs"))
