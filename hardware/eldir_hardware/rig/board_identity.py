"""The identity of a relay board: the socket where it is plugged in, its serial number, or its link.

The kernel's name of a serial port, such as /dev/ttyUSB0, is none of these: it changes when USB renumbers. A
link is weaker than the others, as it may be moved to another board: it decides which stops count, never what
was proven.
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
_LINK_PREFIX = "link:"
_MAX_PARENTS = 12  # from a tty up to its USB device there are four
_MAX_LENGTH = 200  # of one entry in /sys [characters]


@dataclass(frozen=True)
class BoardIdentity:
    """A board behind a port."""

    name: str
    """The kernel's name of the port, such as /dev/ttyUSB0."""
    marks: frozenset[str]
    """Identifying marks that stay when USB renumbers: the link that was used, the place of the socket, the
    serial number; for a port unknown to the kernel, its name and number. Empty if the port has vanished."""
    given_name: str = field(default="", compare=False)
    """The name by which it was found, such as a link."""
    lock: str | None = field(default=None, compare=False)
    """Lock, as /proc/locks names it, of a port that was unplugged while a program holds it."""

    def __str__(self) -> str:
        return self.given_name or self.name

    @property
    def hardware(self) -> frozenset[str]:
        """The marks of the device itself; empty if nothing was connected when they were read."""
        return frozenset(m for m in self.marks if not m.startswith(_LINK_PREFIX))

    def is_same_board(self, other: BoardIdentity) -> bool:
        """Whether a stop of one counts for the other: if they share a mark, such as a link; or the port's
        name if one of them has no mark."""
        if self.marks and other.marks:
            return bool(self.marks & other.marks)
        return self.name == other.name

    def is_same_device(self, other: BoardIdentity) -> bool:
        """Whether a proof for one holds for the other: if they share a hardware mark. If one has none,
        `is_same_board` decides.

        Adapters of one type may share a serial number: they are different while both are connected.
        """
        if not (self.hardware and other.hardware):
            return self.is_same_board(other)
        if not self._count_common(other):
            return False
        return self.name == other.name or locate(self) in (None, other.name)

    def is_open_as(self, handle: int) -> bool:
        """Whether the open file `handle` is this device."""
        return not self.hardware or bool(self._count_common(identify_open(handle)))

    def to_json(self) -> dict[str, Any]:
        """Its entries in a JSON file."""
        return {"name": self.name, "marks": sorted(self.marks)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any], given_name: str = "") -> BoardIdentity:
        """The identity in the entries of a file. Raises `ValueError`, `TypeError` or `KeyError`."""
        name, marks = values["name"], values["marks"]
        if not all(isinstance(text, str) for text in (name, *marks)):
            raise ValueError("an entry is not a text")
        return cls(name, frozenset(marks), given_name)

    def _count_common(self, other: BoardIdentity) -> int:
        """Number of common hardware marks; 0 if the serial numbers differ."""
        mine, theirs = ({m for m in i.marks if m.startswith("usb:")} for i in (self, other))
        return 0 if mine and theirs and mine != theirs else len(self.hardware & other.hardware)


class _Open(Protocol):
    @property
    def file_descriptor(self) -> int: ...

    def close(self) -> None: ...


_Opened = TypeVar("_Opened", bound=_Open)
Port = str | BoardIdentity
"""The name of a port, for whatever is connected there; or a device, wherever it is connected."""


def identify(port: Port, sys: Path = _SYS, links: Path = _LINKS) -> BoardIdentity:
    """The identity of the board at `port`, which need not exist any more. An identity is returned as it is.

    `sys`: the kernel's description of its devices. `links`: folder of udev's links by socket.
    """
    if isinstance(port, BoardIdentity):
        return port
    given_name, name = os.path.abspath(port), os.path.realpath(port)
    marks = set()
    try:
        status = os.stat(name)
    except OSError:
        if os.path.dirname(given_name) not in ("/dev", os.path.dirname(_PSEUDO)):
            marks.add(f"{_LINK_PREFIX}{given_name}")
        return BoardIdentity(name, frozenset(marks), port)
    if os.path.islink(given_name):
        marks.add(f"{_LINK_PREFIX}{given_name}")
    with suppress(OSError):
        marks |= {f"{_LINK_PREFIX}{p}" for p in sorted(links.iterdir()) if os.path.realpath(p) == name}
    return BoardIdentity(name, frozenset(marks | _hardware_marks(name, status, sys)), port)


def identify_open(handle: int, port: str = "") -> BoardIdentity:
    """The identity of an open port, whatever its name or the link `port` refers to now."""
    name = os.readlink(f"/proc/self/fd/{handle}").removesuffix(" (deleted)")
    given_name = os.path.abspath(port or name)
    links = set() if given_name == name else {f"{_LINK_PREFIX}{given_name}"}
    found = identify(name)
    _logger.debug("%s is %s: %s", given_name, name, ", ".join(sorted(found.marks)))
    if os.path.exists(name) and os.path.samestat(os.stat(name), os.fstat(handle)):
        return BoardIdentity(name, found.marks | links, port or name)
    return BoardIdentity(name, frozenset(_hardware_marks(name, os.fstat(handle)) | links), port or name)


def locate(identity: BoardIdentity) -> str | None:
    """The present port of a device; None if it is not connected. A device without hardware marks is
    found by its link or name."""
    links = [m.removeprefix(_LINK_PREFIX) for m in sorted(identity.marks) if m.startswith(_LINK_PREFIX)]
    if not identity.hardware:
        return next((os.path.realpath(link) for link in links if os.path.exists(link)), identity.name)
    best, found = 0, None
    for port in (identity.name, *links, *list_ports()):
        if os.path.exists(port) and (common := identity._count_common(identify(port))) > best:
            best, found = common, os.path.realpath(port)
        if best == len(identity.hardware):
            break
    return found


def open_device(port: Port, open_at: Callable[[str], _Opened], gone: type[EldirError]) -> _Opened:
    """Open a port by its name, or a device wherever it is connected now, not another one with its name.

    Raises `gone` if that device is not connected.
    """
    if isinstance(port, str):
        return open_at(port)
    if where := locate(port):
        opened = open_at(where)
        if port.is_open_as(opened.file_descriptor):
            return opened
        opened.close()
    raise gone(
        f"{port} is not connected, or refers to another device now",
        expected=f"the device of the run, which was {port.name}",
        remedy="connect it to the same socket",
    )


def describe_move(port: str, device: BoardIdentity) -> str:
    """A remark if the name of a port refers to another device than that of the run; otherwise empty."""
    where, there = locate(device), os.path.exists(port)
    if where == os.path.realpath(port) or not (where or there):
        return ""
    names = f"names {os.path.realpath(port)} now" if there else "has gone"
    return f"{port} {names}, and the run drove {where or f'{device.name}, which is not connected'}"


def list_ports() -> list[str]:
    """Names of the serial ports that have hardware."""
    try:
        return [f"/dev/{tty.name}" for tty in _TTYS.iterdir() if (tty / "device").exists()]
    except OSError:
        return []


def is_pseudo_terminal(identity: BoardIdentity) -> bool:
    """Whether the board is emulated."""
    return identity.name.startswith(_PSEUDO)


def is_gone_pseudo_terminal(identity: BoardIdentity) -> bool:
    """Whether this is an emulated board that has ended; its record can never match again."""
    if not identity.marks or not all(m.startswith("pts:") for m in identity.marks):
        return False
    return not identity.marks & identify(identity.name).marks


def _hardware_marks(name: str, status: os.stat_result, sys: Path = _SYS) -> set[str]:
    """Identifiers of the device itself: name and number if the kernel does not know it."""
    marks = _read_kernel_marks(sys, status.st_rdev)
    if name.startswith(_PSEUDO):  # its number is reused soon
        marks.add(f"pts:{name}@{status.st_ctime_ns}")
    device = status.st_rdev
    return marks or {f"node:{name}@{os.major(device)}:{os.minor(device)}"}


def _read_kernel_marks(sys: Path, rdev: int) -> set[str]:
    """Identifiers by socket and serial number of a port that has hardware."""
    tty = sys / "dev" / "char" / f"{os.major(rdev)}:{os.minor(rdev)}"
    device = tty / "device"
    if not device.exists():
        return set()
    place = device.resolve()
    number = _read_text(place / "port_number")  # of an adapter with several ports
    interface = ""
    for folder in (place, *place.parents)[:_MAX_PARENTS]:
        interface = interface or _read_text(folder / "bInterfaceNumber")
        if vendor := _read_text(folder / "idVendor"):
            # The bus number depends on the order of the controllers.
            socket = re.sub(r"^\d+-", "", folder.name)
            above = re.sub(r"/usb\d+(?=/|$)", "/usb", str(folder.parent.relative_to(sys.resolve())))
            above = re.sub(r"/\d+-", "/", above)
            marks = {f"path:{above}/{socket}:{interface}:{number}"}
            if serial := _read_text(folder / "serial"):
                product = _read_text(folder / "idProduct")
                marks.add(f"usb:{vendor}:{product}:{serial}:{interface}:{number}")
            return marks
    return {f"path:{place.relative_to(sys.resolve())}/{tty.resolve().name}"}


def _read_text(file: Path) -> str:
    try:
        return file.read_text()[:_MAX_LENGTH].strip()
    except (OSError, UnicodeDecodeError):
        return ""
