"""Checks of a rig that heat nothing; each failed check names a remedy."""

from __future__ import annotations

import os
import shutil
import stat
import time
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldir.core.files import read_file
from eldir.core.json_text import parse_json
from eldir.design import Design
from eldir.errors import EldirError
from eldir.parameters.wiring import wiring_digest
from eldir_app.notify.delivery import INSTALL, Delivery, is_installed
from eldir_cad.packet.wiring_file import read_wiring
from eldir_hardware.camera.validity import require_valid
from eldir_hardware.guardian.measured_heat import require_no_current
from eldir_hardware.rig.addresses import name_of
from eldir_hardware.rig.boards import open_board, requirements_of
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.packet_wiring import PacketWiring, packet_of, wiring_note
from eldir_hardware.rig.sections import LiveCameraEntry
from eldir_hardware.rig.supply import implausible_springs, worst_springs
from eldir_hardware.safety.latch import LatchedError, require_unlatched
from eldir_hardware.safety.stuck_contact import stuck_temperature

_LEAST_RATE = 5.0  # [frames/s]
_LOG_SPACE = 1e9  # an hour of 60 frames a second takes ten times as much [bytes]


class Finding(NamedTuple):
    """Result of one check."""

    subject: str
    ok: bool
    text: str


def examine(
    rig: Rig,
    folder: Path,
    camera: str | None = None,
    calibrations: Sequence[Path] = (),
    packet: Path | None = None,
) -> list[Finding]:
    """Run all checks. `folder`: of the rig file. `camera`: such as camera:0, instead of the rig's. `packet`:
    folder of the packet that the robot was built from, whose wiring the rig must have."""
    if rig.camera is not None:
        calibrations = [*calibrations, *(folder / f for f in (rig.camera.lens, rig.camera.plane) if f)]
    if camera is None and isinstance(rig.camera, LiveCameraEntry):
        camera = rig.camera.device
    measured = _measured(rig)
    findings = [measured, _springs(rig), _wiring(rig, packet), _stuck(rig, measured), _clock(), _disk(folder)]
    if rig.kind == "virtual" and rig.virtual.design is not None:
        findings.append(_robot(folder / rig.virtual.design))
    if rig.kind == "real" and rig.board.port is not None:
        port = _port(rig.board.port)
        findings.append(port)
        if port.ok:
            findings += [
                _holders(rig.board.port),
                _identity(rig.board.port),
                _latch(rig.board.port),
                _board(rig),
            ]
        if rig.sensor is not None and rig.sensor.port is not None:
            there = _port(rig.sensor.port)
            findings.append(_sensor(rig) if there.ok else there._replace(subject="current sensor"))
    if camera is not None:
        findings += _camera(camera)
    if rig.notify:
        findings += _addresses(rig)
    return findings + [_age(path) for path in calibrations]


def _measured(rig: Rig) -> Finding:
    try:
        worst_springs(rig)
    except EldirError as error:
        return Finding("measurements", False, str(error))
    return Finding("measurements", True, f"{rig.springs.resistance_ohm} Ohm, {rig.supply.current_limit_a} A")


def _springs(rig: Rig) -> Finding:
    """Values that a calibration found may be unusual; others are more likely wrong."""
    wrong = implausible_springs(rig)
    text = "; ".join(wrong.values()) or "thermal constants are within what is published"
    return Finding("springs", wrong.keys() <= rig.springs.calibrated, text)


def _wiring(rig: Rig, packet: Path | None) -> Finding:
    """Another wiring than eldir's own is allowed, another one than that of the robot's packet is not."""
    try:
        if packet is None:
            wanted = packet_of(None, rig.motors)
        else:
            wanted = PacketWiring(read_wiring(packet), str(packet))
        differs = wiring_note(rig, wanted)
    except EldirError as error:
        return Finding("wiring", False, str(error))
    if not differs:
        return Finding("wiring", True, f"as {wanted.source} says ({wiring_digest(wanted.connections)[:8]})")
    text = f"not as {wanted.source} says: {differs}"
    return Finding(
        "wiring", packet is None, text + "; to see which spring grows warm: eldir rig doctor --wiring"
    )


def _stuck(rig: Rig, measured: Finding) -> Finding:
    if not measured.ok:
        return Finding("a welded contact", False, "unknown before the measurements are in the rig file")
    try:
        hottest = stuck_temperature(rig, worst_springs(rig), None)
    except EldirError as error:
        return Finding("a welded contact", False, str(error))
    return Finding("a welded contact", True, f"a cold spring reaches {hottest:.0f} C, below the ceiling")


def _robot(design: Path) -> Finding:
    """The robot on a virtual rig."""
    try:
        Design.load(design)
    except EldirError as error:
        return Finding("robot", False, f"virtual.design: {error}")
    return Finding("robot", True, str(design))


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


def _holders(port: str) -> Finding:
    """Look for the port among the open files of all processes that this user may inspect."""
    real, mine, found = os.path.realpath(port), str(os.getpid()), []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            has = any(os.path.realpath(f) == real for f in (process / "fd").iterdir())
            if has and process.name != mine and not _serves(process, real):
                found.append(f"{(process / 'comm').read_text().strip()} (process {process.name})")
    if not found:
        return Finding("holders", True, "no other program has the port open")
    return Finding("holders", False, f"{', '.join(found)} has the port open; end it (brltty: remove it)")


def _serves(process: Path, port: str) -> bool:
    """Whether it is the other end of that pseudo-terminal, such as `eldir rig emulate`."""
    hosts = (f for f in (process / "fd").iterdir() if os.path.realpath(f).endswith("/ptmx"))
    wanted = ["tty-index:", Path(port).name]
    return any(
        wanted == line.split()
        for host in hosts
        for line in (process / "fdinfo" / host.name).read_text().splitlines()
    )


def _identity(port: str) -> Finding:
    from serial.tools import list_ports

    for device in list_ports.comports():
        if os.path.realpath(device.device) == os.path.realpath(port) and device.vid is not None:
            text = f"USB {device.vid:04x}:{device.pid:04x} {device.product or ''}".rstrip()
            shared = (device.vid, device.pid) == (0x1A86, 0x7523) and "by-path" not in port
            advice = "; many devices share it: name the port by /dev/serial/by-path" if shared else ""
            return Finding("identity", not shared, text + advice)
    return Finding("identity", True, "no USB device: nothing to compare")


def _latch(port: str) -> Finding:
    try:
        require_unlatched(port)
    except LatchedError as error:
        return Finding("emergency stop", False, str(error))
    return Finding("emergency stop", True, "not latched")


def _camera(name: str) -> list[Finding]:
    """Film two seconds: frame rate, and whether the picture is too dark or too bright."""
    from eldir_hardware.vision.sources import open_source

    try:
        frames = list(open_source(name, seconds=2.0))
    except EldirError as error:
        return [Finding("camera", False, str(error))]
    if len(frames) < 2:
        return [Finding("camera", False, f"{len(frames)} frames in two seconds; check its cable")]
    times = np.array([t for t, _ in frames])
    rate, gap = (len(times) - 1) / (times[-1] - times[0]), float(np.diff(times).max())
    steady = rate >= _LEAST_RATE and gap < 3 / rate
    text = f"{rate:.1f} frames a second, longest gap {1e3 * gap:.0f} ms"
    advice = "" if steady else "; more light, shorter exposure, another USB port"
    grey = np.asarray(frames[-1][1])
    dark, bright = float((grey < 8).mean()), float((grey > 247).mean())
    exposed = dark < 0.5 and bright < 0.1
    seen = f"{100 * bright:.0f} % white, {100 * dark:.0f} % black"
    return [
        Finding("camera", steady, text + advice),
        Finding("exposure", exposed, seen + ("" if exposed else "; set the exposure by hand")),
    ]


def _addresses(rig: Rig) -> list[Finding]:
    """Send each address a word: nothing else proves that it arrives."""
    if not is_installed():
        return [Finding("notify", False, f"no word can be sent: {INSTALL}")]
    addresses = [address.get_secret_value() for address in rig.notify]
    failed = Delivery(addresses, f"{rig.name}: a test", "eldir rig doctor checks this address").failures()
    return [
        Finding("notify", False, f"{name} {failed[name]}; correct it in the rig file")
        if name in failed
        else Finding("notify", True, f"{name} took a word as a test")
        for name in (name_of(n, address) for n, address in enumerate(addresses, start=1))
    ]


def _age(path: Path) -> Finding:
    try:
        provenance = parse_json(read_file(path), str(path)).get("provenance", {})
        made = datetime.fromisoformat(provenance["made"])
        days = (datetime.now(UTC) - made).total_seconds() / 86400
        require_valid(provenance, datetime.now(UTC), str(path))
    except EldirError as error:
        return Finding("calibration", False, str(error))
    except (OSError, ValueError, KeyError, AttributeError, TypeError):
        return Finding("calibration", False, f"{path} is no calibration with a date; calibrate again")
    return Finding("calibration", True, f"{path} is {days:.1f} days old and valid")


def _board(rig: Rig) -> Finding:
    try:
        with open_board(rig) as board:
            begun = time.monotonic()
            states = board.states()
            took = time.monotonic() - begun
            board.check_limits(requirements_of(rig))
    except EldirError as error:
        return Finding("board", False, str(error))
    closed = [str(i) for i, state in enumerate(states, start=1) if state]
    if closed:
        return Finding("board", False, f"channels {', '.join(closed)} are closed; open them: eldir rig off")
    return Finding("board", True, f"{rig.board.kind}, all open, answers within {1e3 * took:.0f} ms")


def _sensor(rig: Rig) -> Finding:
    """Whether it answers, has the chips of the rig file, and sees no current now that contacts are open."""
    try:
        text = require_no_current(rig)
    except EldirError as error:
        return Finding("current sensor", False, str(error))
    if {c.channel for c in rig.channels} - set(rig.measured_channels):
        return Finding("current sensor", False, f"{text}: add inputs")
    return Finding("current sensor", True, str(text))


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
    return Finding("disk", ok, f"{free / 1e9:.1f} GB free" + ("" if ok else "; free disk space for logs"))
