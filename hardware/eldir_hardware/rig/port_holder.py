"""Which process holds a port, as the kernel shows it: there is no file of who drives.

One process at a time drives a port: it holds the kernel's `flock` on the device node itself, which pyserial
takes when it opens the port. It works across users, ends with the process, and cannot be held without
opening the device. Emulators and other programs may have the device open without it: they do not drive.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from eldir_hardware.rig.board_identity import BoardIdentity, Port, locate

GUARDIAN_WORD = "eldir-guardian"
"""The word in a guardian's command line before its socket, device, kind of board, number of channels, and the
name by which the device was given."""
_PROC = Path("/proc")


class Holder(NamedTuple):
    """A process that holds the lock of a port."""

    process: int
    user: int | None
    """Number of its user."""
    suspended: bool
    """Whether it is suspended, as by SIGSTOP, and cannot react."""


class GuardedPort(NamedTuple):
    """A port that a guardian holds."""

    process: int
    port: str
    """The device whose lock it holds, such as /dev/ttyUSB0."""
    kind: str
    channels: int
    given_name: str
    """The name by which the device was given, such as a link; it may refer to another one now."""
    lock: str
    """Identifier of the lock in /proc/locks."""


def find_holder(port: Port) -> Holder | None:
    """The process that holds the lock of `port`, or None."""
    device = get_lock(port)
    if device is None:
        return None
    unreadable = None
    for process in (p for p, name in _read_locks() if name == device):
        shows_lock = _shows_lock(process, device)
        if shows_lock:
            return _read_holder(process)
        if shows_lock is None:
            unreadable = unreadable or _read_holder(process)
        else:  # it has passed the lock to a child and ended; its number may be reused
            for other in _list_processes():
                if _shows_lock(other, device):
                    return _read_holder(other)
    return unreadable


def get_lock(port: Port) -> str | None:
    """The lock of a port as /proc/locks names it; None if it is not connected and no program holds it."""
    if isinstance(port, BoardIdentity):
        if port.lock is not None:
            return port.lock
        port = locate(port) or ""
    try:
        return _lock_name(os.stat(port))
    except OSError:
        return None


def signal_holder(port: Port, process: int, number: signal.Signals) -> bool:
    """Send a signal to the process that holds the lock of `port`. Returns whether it was sent.

    A pidfd stands for one process, whatever becomes of its number. That this process shows the lock is
    checked after the pidfd was opened. Raises `PermissionError` for a process of another user.
    """
    try:
        handle = os.pidfd_open(process)
    except ProcessLookupError:
        return False
    try:
        device = get_lock(port)
        if device is None or not _shows_lock(process, device):
            return False
        signal.pidfd_send_signal(handle, number)
    except (ProcessLookupError, FileNotFoundError):
        return False
    finally:
        os.close(handle)
    return True


def list_guarded_ports() -> list[GuardedPort]:
    """Ports that guardians hold now, of all users whose processes can be seen.

    The lock identifies the device, not the command line of a guardian, whose port may be a link that was
    moved.
    """
    found = []
    for process, lock in _read_locks():
        with suppress(OSError, ValueError, IndexError):
            words = (_PROC / str(process) / "cmdline").read_bytes().decode(errors="replace").split("\0")
            place = words.index(GUARDIAN_WORD)
            port, kind, channels, given_name = words[place + 2 : place + 6]
            if lock == get_lock(port) or lock == _lock_of_unplugged(process, port):
                found.append(GuardedPort(process, port, kind, int(channels), given_name, lock))
    return found


def _lock_of_unplugged(process: int, port: str) -> str | None:
    """The lock of a process on a port that was unplugged."""
    for file in (_PROC / str(process) / "fd").iterdir():
        if os.readlink(file) == f"{port} (deleted)":
            return _lock_name(file.stat())
    return None


def _read_locks() -> Iterator[tuple[int, str]]:
    """Process and device of every exclusive flock, such as (1234, "00:1a:4")."""
    with suppress(OSError):
        for line in (_PROC / "locks").read_text().splitlines():
            match line.split():
                case [_, "FLOCK", _, "WRITE", process, device, *_] if process.isdigit():
                    yield int(process), device


def _lock_name(status: os.stat_result) -> str:
    """A file as /proc/locks names it: device of its file system, inode."""
    return f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"


def _shows_lock(process: int, device: str) -> bool | None:
    """Whether an open file of that process bears the lock; None if its files must not be read."""
    folder = _PROC / str(process) / "fdinfo"
    try:
        files = list(folder.iterdir())
    except PermissionError:
        return None
    except OSError:
        return False
    for file in files:
        with suppress(OSError):
            for line in file.read_text().splitlines():
                if line.startswith("lock:") and "FLOCK" in line and device in line.split():
                    return True
    return False


def _list_processes() -> Iterator[int]:
    return (int(p.name) for p in _PROC.iterdir() if p.name.isdigit())


def _read_holder(process: int) -> Holder:
    user, suspended = None, False
    with suppress(OSError, IndexError):
        user = (_PROC / str(process)).stat().st_uid
        state = (_PROC / str(process) / "stat").read_text().rpartition(")")[2].split()[0]
        suspended = state in "Tt"
    return Holder(process, user, suspended)
