"""One process at a time drives a port: it holds a lock on a file, which the kernel frees even after SIGKILL.

The owner removes the file when it releases the lock. A process that had opened the file before would then
lock a file without a name, so a lock counts only while the file has its name.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from eldir.errors import EldirError

_FOLDER = Path("/tmp")  # the same for everyone, whatever their TMPDIR
_PSEUDO = "/dev/pts/"
_PATIENCE = 3.0  # from SIGTERM to SIGKILL [s]


def port_file(port: str, purpose: str = "port") -> Path:
    """Path of the file that stands for a port, the same for every link to the port and every terminal.

    The number of a pseudo-terminal is soon used again, so its creation time is part of the name.
    """
    name = os.path.realpath(port)
    if name.startswith(_PSEUDO):
        with suppress(OSError):
            name += str(os.stat(name).st_ctime_ns)
    return _FOLDER / f"eldir-{purpose}-{hashlib.sha256(name.encode()).hexdigest()[:16]}"


@contextmanager
def port_lock(port: str) -> Iterator[None]:
    """While the context is open, this process alone drives the port. Raises `EldirError` if another does."""
    path = port_file(port)  # a pseudo-terminal that is gone at the end could not be asked for its name
    with _locked(path, port) as file:
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        try:
            yield
        finally:
            if _named(file, path):
                path.unlink()


def _locked(path: Path, port: str) -> TextIO:
    """Open, lock and return the port's file; it is created if needed."""
    while True:
        try:
            file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o600), "r+")
        except OSError as error:
            raise EldirError(
                f"cannot lock {port} with {path}: {error.strerror}",
                remedy="another user drives it; if their program was killed, remove that file",
            ) from None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            with file:
                raise EldirError(
                    f"process {_reader(file.read())} already drives {port}",
                    remedy="wait for it, or stop it: eldir rig off",
                ) from None
        if _named(file, path):
            return file
        file.close()


def _named(file: TextIO, path: Path) -> bool:
    """Whether the open file is still the one that is found at `path`."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


def stop_holder(port: str) -> int | None:
    """Stop the process that drives `port` and return its number, or None if there is none.

    It gets SIGTERM, and SIGKILL if it does not end: the caller opens the contacts next.
    """
    try:
        file = port_file(port).open()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise EldirError(
            f"cannot find out who drives {port}: {error.strerror}",
            remedy="another user drives it; cut the heating supply, or run this as that user",
        ) from None
    with file:
        stopped, killed = None, False
        deadline = time.monotonic() + _PATIENCE
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return stopped
            except OSError:
                file.seek(0)
                holder = file.read().strip()
            if stopped is None and holder.isdigit():
                stopped = int(holder)
                _signal(stopped, signal.SIGTERM)
            if time.monotonic() > deadline and stopped is not None and not killed:
                killed = True
                deadline += 1.0
                _signal(stopped, signal.SIGKILL)
            if time.monotonic() > deadline:
                raise EldirError(
                    f"process {_reader(holder)} holds {port} and does not end",
                    remedy="cut the heating supply",
                )
            time.sleep(0.02)


def _signal(process: int, number: signal.Signals) -> None:
    with suppress(ProcessLookupError):  # it has just ended by itself
        os.kill(process, number)


def _reader(text: str) -> str:
    return text.strip() or "unknown"
