"""Checks of a rig that switch no contact; each failed check names a remedy."""

from __future__ import annotations

import os
import shutil
import stat
import statistics
import time
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldir.core.files import parse_json, read_file
from eldir.design import Design
from eldir.errors import EldirError
from eldir.parameters.wiring import wiring_digest
from eldir_app.notifications import INSTALL, Delivery, is_installed
from eldir_cad.packet.wiring_file import read_wiring
from eldir_hardware.camera.lens import require_not_expired
from eldir_hardware.guardian.measured_heat import require_no_current
from eldir_hardware.rig.addresses import describe_address
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_requirements, open_board
from eldir_hardware.rig.sections import LiveCameraEntry
from eldir_hardware.rig.supply import find_implausible_springs, worst_springs
from eldir_hardware.run.room import query_thermometer
from eldir_hardware.safety.compatibility import PacketWiring, compare_wiring, packet_wiring
from eldir_hardware.safety.latch import LatchedError, require_unlatched
from eldir_hardware.safety.limits import check_rig, check_room
from eldir_hardware.safety.worst_heat import stuck_temperature

_MIN_FRAME_RATE_HZ = 5.0
_MIN_FREE_BYTES = 1e9  # an hour of 60 frames a second takes ten times as much


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
    """Run all checks.

    `folder`: of the rig file. `camera`: such as camera:0, instead of the rig's. `packet`: folder of the
    packet that the robot was built from, whose wiring the rig must have.
    """
    if rig.camera is not None:
        calibrations = [*calibrations, *(folder / f for f in (rig.camera.lens, rig.camera.plane) if f)]
    if camera is None and isinstance(rig.camera, LiveCameraEntry):
        camera = rig.camera.device
    measurements = check_measurements(rig)
    findings = [
        measurements,
        check_springs(rig),
        check_wiring(rig, packet),
        check_welded_contact(rig, measurements),
        check_disk(folder),
    ]
    if rig.kind == "real" or rig.virtual.clock == "wall":
        findings.append(check_clock())
    if rig.kind == "virtual" and rig.virtual.design is not None:
        findings.append(check_virtual_robot(folder / rig.virtual.design))
    if rig.kind == "real" and rig.board.port is not None:
        port = check_port(rig.board.port)
        findings.append(port)
        if port.ok:
            findings += [
                check_port_holders(rig.board.port),
                check_usb_identity(rig.board.port),
                check_latch(rig.board.port),
                check_board(rig),
            ]
        if rig.sensor is not None and rig.sensor.port is not None:
            port = check_port(rig.sensor.port)
            findings.append(check_sensor(rig) if port.ok else port._replace(subject="current sensor"))
    if rig.thermometer is not None:
        findings.append(check_thermometer(rig))
    if camera is not None:
        findings += check_camera(camera)
    if rig.notify:
        findings += check_notifications(rig)
    return findings + [check_calibration(path) for path in calibrations]


def check_measurements(rig: Rig) -> Finding:
    try:
        worst_springs(rig)
    except EldirError as error:
        return Finding("measurements", False, str(error))
    return Finding("measurements", True, f"{rig.springs.resistance_ohm} Ohm, {rig.supply.current_limit_a} A")


def check_springs(rig: Rig) -> Finding:
    """Implausible values that a calibration found may be right; other ones are more likely wrong."""
    implausible = find_implausible_springs(rig)
    text = "; ".join(implausible.values()) or "thermal constants are within the published range"
    return Finding("springs", implausible.keys() <= rig.springs.calibrated, text)


def check_wiring(rig: Rig, packet: Path | None) -> Finding:
    """The wiring may differ from eldir's default, but not from that of the robot's packet."""
    try:
        if packet is None:
            expected = packet_wiring(None, rig.motors, rig)
        else:
            expected = PacketWiring(read_wiring(packet), str(packet))
        difference = compare_wiring(rig, expected)
    except EldirError as error:
        return Finding("wiring", False, str(error))
    if not difference:
        text = f"as {expected.source} says ({wiring_digest(expected.connections)[:8]})"
        return Finding("wiring", True, text)
    text = f"not as {expected.source} says: {difference}"
    return Finding(
        "wiring", packet is None, f"{text}; to see which spring grows warm: eldir rig doctor --wiring"
    )


def check_welded_contact(rig: Rig, measurements: Finding) -> Finding:
    if not measurements.ok:
        return Finding("a welded contact", False, "unknown until the measurements are in the rig file")
    try:
        check_rig(rig)  # also the cut-off's dependence on the board, and the contacts' rating
        hottest = stuck_temperature(rig, worst_springs(rig), None)
        limit = rig.limits.max_temperature_c
    except EldirError as error:
        return Finding("a welded contact", False, str(error))
    return Finding(
        "a welded contact", True, f"a cold spring reaches {hottest:.0f} C, {limit:g} C are allowed"
    )


def check_virtual_robot(design: Path) -> Finding:
    """Whether the design of the robot on a virtual rig can be read."""
    try:
        Design.load(design)
    except EldirError as error:
        return Finding("robot", False, f"virtual.design: {error}")
    return Finding("robot", True, str(design))


def check_port(port: str) -> Finding:
    try:
        mode = os.stat(port).st_mode
    except OSError as error:
        return Finding("port", False, f"{port}: {error.strerror}; look under /dev/serial/by-path")
    if not stat.S_ISCHR(mode):
        return Finding("port", False, f"{port} is not a serial device; look under /dev/serial/by-path")
    if not os.access(port, os.R_OK | os.W_OK):
        return Finding("port", False, f"no permission for {port}; join its group: usermod -aG dialout USER")
    return Finding("port", True, port)


def check_port_holders(port: str) -> Finding:
    """Look for the port among the open files of all processes that this user may inspect."""
    device, own, holders = os.path.realpath(port), str(os.getpid()), []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            is_open = any(os.path.realpath(f) == device for f in (process / "fd").iterdir())
            if is_open and process.name != own and not _is_emulator_of(process, device):
                holders.append(f"{(process / 'comm').read_text().strip()} (process {process.name})")
    if not holders:
        return Finding("holders", True, "no other program has the port open")
    return Finding("holders", False, f"{', '.join(holders)} has the port open; end it (brltty: remove it)")


def _is_emulator_of(process: Path, port: str) -> bool:
    """Whether a process is the other end of that pseudo-terminal, such as `eldir rig emulate`."""
    hosts = (f for f in (process / "fd").iterdir() if os.path.realpath(f).endswith("/ptmx"))
    expected = ["tty-index:", Path(port).name]
    return any(
        expected == line.split()
        for host in hosts
        for line in (process / "fdinfo" / host.name).read_text().splitlines()
    )


def check_usb_identity(port: str) -> Finding:
    from serial.tools import list_ports

    for device in list_ports.comports():
        if os.path.realpath(device.device) == os.path.realpath(port) and device.vid is not None:
            text = f"USB {device.vid:04x}:{device.pid:04x} {device.product or ''}".rstrip()
            shared = (device.vid, device.pid) == (0x1A86, 0x7523) and "by-path" not in port
            advice = "; many devices share it: name the port by /dev/serial/by-path" if shared else ""
            return Finding("identity", not shared, text + advice)
    return Finding("identity", True, "not a USB device: nothing to compare")


def check_latch(port: str) -> Finding:
    try:
        require_unlatched(port)
    except LatchedError as error:
        return Finding("emergency stop", False, str(error))
    return Finding("emergency stop", True, "not latched")


def check_camera(name: str) -> list[Finding]:
    """Film for two seconds: frame rate, and whether the picture is too dark or too bright."""
    from eldir_hardware.vision.sources import open_source

    try:
        frames = list(open_source(name, seconds=2.0))
    except EldirError as error:
        return [Finding("camera", False, str(error))]
    if len(frames) < 2:
        return [Finding("camera", False, f"{len(frames)} frames in two seconds; check its cable")]
    times = np.array([t for t, _ in frames])
    rate, gap = (len(times) - 1) / (times[-1] - times[0]), float(np.diff(times).max())
    steady = rate >= _MIN_FRAME_RATE_HZ and gap < 3 / rate
    text = f"{rate:.1f} frames a second, longest gap {1e3 * gap:.0f} ms"
    advice = "" if steady else "; more light, shorter exposure, another USB port"
    grey = np.asarray(frames[-1][1])
    dark, bright = float((grey < 8).mean()), float((grey > 247).mean())
    exposed = dark < 0.5 and bright < 0.1
    clipping = f"{100 * bright:.0f} % white, {100 * dark:.0f} % black"
    return [
        Finding("camera", steady, text + advice),
        Finding("exposure", exposed, clipping + ("" if exposed else "; set the exposure by hand")),
    ]


def check_notifications(rig: Rig) -> list[Finding]:
    """Send a test notification to each address: nothing else proves that it arrives."""
    if not is_installed():
        return [Finding("notify", False, f"apprise is not installed: {INSTALL}")]
    addresses = [address.get_secret_value() for address in rig.notify]
    title, text = f"{rig.name}: a test", "eldir rig doctor checks this address"
    failed = Delivery(addresses, title, text).failures()
    return [
        Finding("notify", False, f"{name} {failed[name]}; correct it in the rig file")
        if name in failed
        else Finding("notify", True, f"{name} accepted a test notification")
        for name in (describe_address(n, address) for n, address in enumerate(addresses, start=1))
    ]


def check_calibration(path: Path) -> Finding:
    try:
        provenance = parse_json(read_file(path), str(path)).get("provenance", {})
        created = datetime.fromisoformat(provenance["made"])
        days = (datetime.now(UTC) - created).total_seconds() / 86400
        require_not_expired(provenance, datetime.now(UTC), str(path))
    except EldirError as error:
        return Finding("calibration", False, str(error))
    except (OSError, ValueError, KeyError, AttributeError, TypeError):
        return Finding("calibration", False, f"{path} is not a calibration file with a date; calibrate again")
    return Finding("calibration", True, f"{path} is {days:.1f} days old and valid")


def check_board(rig: Rig) -> Finding:
    try:
        with open_board(rig) as board:
            start = time.monotonic()
            states = board.read_states()
            duration = time.monotonic() - start
            board.check_limits(get_requirements(rig))
    except EldirError as error:
        return Finding("board", False, str(error))
    closed = [str(i) for i, state in enumerate(states, start=1) if state]
    if closed:
        return Finding("board", False, f"channels {', '.join(closed)} are closed; open them: eldir rig off")
    return Finding("board", True, f"{rig.board.kind}, all open, answers within {1e3 * duration:.0f} ms")


def check_sensor(rig: Rig) -> Finding:
    """Whether the sensor answers, has the chips of the rig file, and measures no current while all contacts
    are open."""
    try:
        text = require_no_current(rig)
    except EldirError as error:
        return Finding("current sensor", False, str(error))
    if {c.channel for c in rig.channels} - set(rig.measured_channels):
        return Finding("current sensor", False, f"{text}: add inputs")
    return Finding("current sensor", True, str(text))


def check_thermometer(rig: Rig) -> Finding:
    """What the thermometer shows, and whether limits are checked for air of this temperature."""
    try:
        shown = query_thermometer(rig)
        check_room(rig, shown)
    except EldirError as error:
        return Finding("thermometer", False, str(error))
    return Finding("thermometer", True, f"the air has {shown:.1f} C, within the tolerances")


def check_clock() -> Finding:
    """Whether this computer wakes in time; one look may hit the only moment in which it does not."""
    resolution = time.get_clock_info("monotonic").resolution
    late = statistics.median(_oversleep() for _ in range(9))
    ok = resolution <= 1e-3 and late < 0.02
    text = f"resolution {resolution:g} s, wakes {1e3 * late:.1f} ms late"
    return Finding("clock", ok, text if ok else f"{text}; close other programs")


def _oversleep() -> float:
    start = time.monotonic()
    time.sleep(0.01)
    return time.monotonic() - start - 0.01


def check_disk(folder: Path) -> Finding:
    free = shutil.disk_usage(folder).free
    ok = free >= _MIN_FREE_BYTES
    return Finding("disk", ok, f"{free / 1e9:.1f} GB free" + ("" if ok else "; free disk space for logs"))
