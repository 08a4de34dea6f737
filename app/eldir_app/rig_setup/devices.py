"""What is connected to this computer: serial ports, found by unplugging, and cameras that give pictures."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from eldir.errors import InputError
from eldir_app.doctor import check_port
from eldir_app.rig_setup.dialogue import Dialogue
from eldir_hardware.clock import Clock, WallClock
from eldir_hardware.rig._board_hints import find_port_problem
from eldir_hardware.rig.addresses import is_camera
from eldir_hardware.rig.board_identity import list_ports

LINKS = Path("/dev/serial/by-path")
"""Folder of the links by socket: a port keeps its link after a restart."""
_USB_S, _USB_STEP_S = 3.0, 0.1
"""How long a device may take to appear or vanish, and how often to look [s]."""


def require_port(port: str) -> str:
    """The port, if it is a serial port that can be opened. Raises `InputError`."""
    if problem := find_port_problem(port):
        raise InputError(problem, expected="a serial port, such as /dev/serial/by-path/...")
    if not (finding := check_port(port)).ok:
        raise InputError(finding.text)
    return port


def connected_ports(links: Path = LINKS) -> set[str]:
    """The serial ports that are connected: each by its link by socket, or by its name if it has none."""
    try:
        found = {os.path.realpath(link): str(link) for link in sorted(links.iterdir(), reverse=True)}
    except OSError:
        found = {}
    return {*found.values(), *(name for name in list_ports() if name not in found)}


def find_replugged(dialogue: Dialogue, links: Path = LINKS, clock: Clock | None = None) -> str:
    """The port that vanishes and comes back while the person unplugs the relay board and plugs it in again.

    Raises `InputError` if it is not exactly one.
    """
    clock = clock or WallClock()
    if not dialogue.is_interactive:
        raise InputError("a board is found by unplugging it at a terminal only", remedy="name its port")
    before = connected_ports(links)
    dialogue.wait_for_enter("Unplug the USB cable of the relay board")
    gone = _wait_for_change(lambda: before - connected_ports(links), clock)
    if len(gone) != 1:
        raise InputError(
            f"{len(gone)} serial ports vanished",
            expected="the one of the relay board",
            found=", ".join(sorted(gone)) or "none",
            remedy="unplug nothing else, or name the port",
        )
    without = connected_ports(links)
    dialogue.wait_for_enter("Plug it in again, into the same socket")
    back = _wait_for_change(lambda: connected_ports(links) - without, clock)
    if len(back) != 1:
        raise InputError(
            f"{len(back)} serial ports came back",
            expected=f"one, such as {min(gone)}",
            found=", ".join(sorted(back)) or "none",
            remedy="check the cable",
        )
    return back.pop()


def _wait_for_change(changed: Callable[[], set[str]], clock: Clock) -> set[str]:
    """The ports that changed; those of one device may change one after the other."""
    deadline = clock.now() + _USB_S
    while not (found := changed()) and clock.now() < deadline:
        clock.sleep_until(clock.now() + _USB_STEP_S)
    clock.sleep_until(clock.now() + _USB_STEP_S)
    return changed() if found else found


def list_cameras(devices: Path = Path("/dev")) -> dict[str, tuple[int, int]]:
    """The cameras of this computer that give pictures, with the width and height of these [px]."""
    found = {}
    for number in sorted(int(d.name[5:]) for d in devices.glob("video*") if d.name[5:].isdecimal()):
        try:
            found[f"camera:{number}"] = measure_picture(f"camera:{number}")
        except InputError:  # a camera has other devices too, which give none
            continue
    return found


def measure_picture(camera: str) -> tuple[int, int]:
    """Width and height of the pictures of a camera [px]. Raises `InputError` if it gives none."""
    from eldir_hardware.vision.sources import CameraDevice

    if not is_camera(camera):
        raise InputError(
            "invalid name of a camera",
            expected="camera:0, /dev/video0, http://... or rtsp://...",
            found=repr(camera),
        )
    with closing(CameraDevice(camera, seconds=0.0).frames()) as frames:
        height, width = next(frames)[1].shape[:2]
    return width, height
