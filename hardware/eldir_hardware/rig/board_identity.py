"""What tells one relay board from another: the place where it is plugged in, its serial number, or its link.

The kernel's name of a serial port, such as /dev/ttyUSB0, is none of these: it changes when USB renumbers. A
link is weaker than the others: it may be moved to another board. It says which stops count, never what was
proven.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

from eldir.errors import EldirError

_logger = logging.getLogger(__name__)

_PSEUDO = "/dev/pts/"
_SYS = Path("/sys")
_LINKS = Path("/dev/serial/by-path")
_TTYS = Path("/sys/class/tty")
_LINK = "link:"
_PARENTS = 12  # from a tty up to its USB device there are four
_LONGEST = 200  # of one entry in /sys [characters]


@dataclass(frozen=True)
class BoardIdentity:
    """A board behind a port."""

    name: str
    """The kernel's name of the port, such as /dev/ttyUSB0."""
    marks: frozenset[str]
    """What stays when USB renumbers: the link that was used, the place of the socket, the serial number; for
    a port of which the kernel says nothing, its name and number. Empty if the port has gone."""
    given: str = field(default="", compare=False)
    """The name by which it was found, such as a link."""
    lock: str | None = field(default=None, compare=False)
    """Of a port that was unplugged while a program holds it: its lock as /proc/locks names it."""

    def __str__(self) -> str:
        return self.given or self.name

    @property
    def hardware(self) -> frozenset[str]:
        """The marks of the device itself; empty if nothing was connected when they were taken."""
        return frozenset(m for m in self.marks if not m.startswith(_LINK))

    def same_board(self, other: BoardIdentity) -> bool:
        """Whether a stop of one counts for the other: by any common mark, the same link too; by the port's
        name if one of them has no mark."""
        if self.marks and other.marks:
            return bool(self.marks & other.marks)
        return self.name == other.name

    def same_device(self, other: BoardIdentity) -> bool:
        """Whether what one proves is proven of the other: by the hardware; by any mark if one has none.

        Adapters of one type may share a serial number: then it is not the other as long as the one is still
        connected elsewhere.
        """
        if not (self.hardware and other.hardware):
            return self.same_board(other)
        if not self._common(other):
            return False
        return self.name == other.name or locate(self) in (None, other.name)

    def is_behind(self, handle: int) -> bool:
        """Whether an open file is this device."""
        return not self.hardware or bool(self._common(identify_open(handle)))

    def values(self) -> dict[str, Any]:
        """Its values in a file."""
        return {"name": self.name, "marks": sorted(self.marks)}

    @classmethod
    def of(cls, values: Mapping[str, Any], given: str = "") -> BoardIdentity:
        """The identity in a file's values. Raises `ValueError`, `TypeError` or `KeyError`."""
        name, marks = values["name"], values["marks"]
        if not all(isinstance(text, str) for text in (name, *marks)):
            raise ValueError("an entry is no text")
        return cls(name, frozenset(marks), given)

    def _common(self, other: BoardIdentity) -> int:
        """Number of common marks of the hardware; 0 where the serial numbers differ."""
        mine, theirs = ({m for m in i.marks if m.startswith("usb:")} for i in (self, other))
        return 0 if mine and theirs and mine != theirs else len(self.hardware & other.hardware)


class _Open(Protocol):
    @property
    def handle(self) -> int: ...

    def close(self) -> None: ...


_Opened = TypeVar("_Opened", bound=_Open)
Port = str | BoardIdentity
"""A port by its name: whatever is there now. Or a device, wherever it is connected now."""


def identify(port: Port, sys: Path = _SYS, links: Path = _LINKS) -> BoardIdentity:
    """The identity of the board at `port`, which need not exist any more; an identity stays what it is.

    `sys`: where the kernel describes its devices. `links`: folder of udev's links by the place of the socket.
    """
    if isinstance(port, BoardIdentity):
        return port
    given, name = os.path.abspath(port), os.path.realpath(port)
    marks = set()
    try:
        status = os.stat(name)
    except OSError:
        if os.path.dirname(given) not in ("/dev", os.path.dirname(_PSEUDO)):
            marks.add(f"{_LINK}{given}")
        return BoardIdentity(name, frozenset(marks), port)
    if os.path.islink(given):
        marks.add(f"{_LINK}{given}")
    with suppress(OSError):
        marks |= {f"{_LINK}{p}" for p in sorted(links.iterdir()) if os.path.realpath(p) == name}
    return BoardIdentity(name, frozenset(marks | _hardware(name, status, sys)), port)


def identify_open(handle: int, port: str = "") -> BoardIdentity:
    """The identity of an open port, whatever its name, or the link `port` to it, names by now."""
    name = os.readlink(f"/proc/self/fd/{handle}").removesuffix(" (deleted)")
    given = os.path.abspath(port or name)
    links = set() if given == name else {f"{_LINK}{given}"}
    found = identify(name)
    _logger.debug("%s is %s: %s", given, name, ", ".join(sorted(found.marks)))
    if os.path.exists(name) and os.path.samestat(os.stat(name), os.fstat(handle)):
        return BoardIdentity(name, found.marks | links, port or name)
    return BoardIdentity(name, frozenset(_hardware(name, os.fstat(handle)) | links), port or name)


def locate(identity: BoardIdentity) -> str | None:
    """Where a device is now; None if it is not connected. One that has no marks of hardware is where its link
    or its name is: nothing else tells."""
    links = [m.removeprefix(_LINK) for m in sorted(identity.marks) if m.startswith(_LINK)]
    if not identity.hardware:
        return next((os.path.realpath(link) for link in links if os.path.exists(link)), identity.name)
    best, found = 0, None
    for port in (identity.name, *links, *ports()):
        if os.path.exists(port) and (common := identity._common(identify(port))) > best:
            best, found = common, os.path.realpath(port)
        if best == len(identity.hardware):
            break
    return found


def open_device(port: Port, open_at: Callable[[str], _Opened], gone: type[EldirError]) -> _Opened:
    """Open a port by its name, or a device wherever it is connected now, and none that has taken its name.

    Raises `gone` where that device is not connected.
    """
    if isinstance(port, str):
        return open_at(port)
    if where := locate(port):
        opened = open_at(where)
        if port.is_behind(opened.handle):
            return opened
        opened.close()
    raise gone(
        f"{port} is not connected, or names another device now",
        expected=f"that of the run, which was {port.name}",
        remedy="connect it where it was",
    )


def moved(port: str, device: BoardIdentity) -> str:
    """What a user must know where the name of a port stands for another device than that of the run; empty
    where it does not."""
    where, there = locate(device), os.path.exists(port)
    if where == os.path.realpath(port) or not (where or there):
        return ""
    names = f"names {os.path.realpath(port)} now" if there else "has gone"
    return f"{port} {names}, and the run drove {where or f'{device.name}, which is not connected'}"


def ports() -> list[str]:
    """Serial ports that have hardware."""
    try:
        return [f"/dev/{tty.name}" for tty in _TTYS.iterdir() if (tty / "device").exists()]
    except OSError:
        return []


def is_pseudo_terminal(identity: BoardIdentity) -> bool:
    """Whether the board is an emulated one."""
    return identity.name.startswith(_PSEUDO)


def is_gone_pseudo_terminal(identity: BoardIdentity) -> bool:
    """Whether the record of such a board can never match again."""
    if not identity.marks or not all(m.startswith("pts:") for m in identity.marks):
        return False
    return not identity.marks & identify(identity.name).marks


def _hardware(name: str, status: os.stat_result, sys: Path = _SYS) -> set[str]:
    """Marks of the device itself. One of which the kernel says nothing is known by its name and number."""
    marks = _from_kernel(sys, status.st_rdev)
    if name.startswith(_PSEUDO):  # its number is soon used again
        marks.add(f"pts:{name}@{status.st_ctime_ns}")
    device = status.st_rdev
    return marks or {f"node:{name}@{os.major(device)}:{os.minor(device)}"}


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
