"""What tells one relay board from another: the place where it is plugged in, its serial number, or its link.

The kernel's name of a serial port, such as /dev/ttyUSB0, is none of these: it changes when USB renumbers.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_PSEUDO = "/dev/pts/"
_SYS = Path("/sys")
_LINKS = Path("/dev/serial/by-path")
_PARENTS = 12  # from a tty up to its USB device there are four
_LONGEST = 200  # of one entry in /sys [characters]


@dataclass(frozen=True)
class BoardIdentity:
    """A board behind a port."""

    name: str
    """The kernel's name of the port, such as /dev/ttyUSB0."""
    marks: frozenset[str]
    """What stays when USB renumbers. Empty if the port has gone or has no such mark."""

    def same_board(self, other: BoardIdentity) -> bool:
        """Whether both are one board: by any common mark; by the port's name if one of them has no mark."""
        if self.marks and other.marks:
            return bool(self.marks & other.marks)
        return self.name == other.name


def identify(port: str, sys: Path = _SYS, links: Path = _LINKS) -> BoardIdentity:
    """The identity of the board at `port`, which need not exist any more.

    `sys`: where the kernel describes its devices. `links`: folder of udev's links by the place of the socket.
    """
    given, name = os.path.abspath(port), os.path.realpath(port)
    marks = set()
    try:
        status = os.stat(name)
    except OSError:
        if os.path.dirname(given) not in ("/dev", os.path.dirname(_PSEUDO)):
            marks.add(f"link:{given}")
        return BoardIdentity(name, frozenset(marks))
    if os.path.islink(given):
        marks.add(f"link:{given}")
    if name.startswith(_PSEUDO):  # its number is soon used again
        marks.add(f"pts:{name}@{status.st_ctime_ns}")
    with suppress(OSError):
        marks |= {f"link:{p}" for p in sorted(links.iterdir()) if os.path.realpath(p) == name}
    marks |= _from_kernel(sys, status.st_rdev)
    return BoardIdentity(name, frozenset(marks))


def is_pseudo_terminal(identity: BoardIdentity) -> bool:
    """Whether the board is an emulated one."""
    return identity.name.startswith(_PSEUDO)


def is_gone_pseudo_terminal(identity: BoardIdentity) -> bool:
    """Whether the record of such a board can never match again."""
    if not identity.marks or not all(m.startswith("pts:") for m in identity.marks):
        return False
    return not identity.marks & identify(identity.name).marks


def _from_kernel(sys: Path, rdev: int) -> set[str]:
    """Place and serial number of a port that has hardware."""
    tty = sys / "dev" / "char" / f"{os.major(rdev)}:{os.minor(rdev)}"
    device = tty / "device"
    if not device.exists():
        return set()
    place = device.resolve()
    number = _text(place / "port_number")  # of an adapter with several ports
    interface = ""
    for folder in (place, *place.parents)[:_PARENTS]:
        interface = interface or _text(folder / "bInterfaceNumber")
        if vendor := _text(folder / "idVendor"):
            socket = re.sub(
                r"^\d+-", "", folder.name
            )  # the bus number depends on the order of the controllers
            above = re.sub(r"/usb\d+(?=/|$)", "/usb", str(folder.parent.relative_to(sys.resolve())))
            above = re.sub(r"/\d+-", "/", above)
            marks = {f"path:{above}/{socket}:{interface}:{number}"}
            if serial := _text(folder / "serial"):
                product = _text(folder / "idProduct")
                marks.add(f"usb:{vendor}:{product}:{serial}:{interface}:{number}")
            return marks
    return {f"path:{place.relative_to(sys.resolve())}/{tty.resolve().name}"}


def _text(file: Path) -> str:
    try:
        return file.read_text()[:_LONGEST].strip()
    except (OSError, UnicodeDecodeError):
        return ""
