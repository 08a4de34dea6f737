"""The folder of the latched stops, which other users cannot write.

/var/lib/eldir if an administrator made it for a group; otherwise this user's $XDG_STATE_HOME/eldir or
~/.local/state/eldir. No file is opened through a link, and none is trusted that others could have written.
"""

from __future__ import annotations

import fcntl
import os
import pwd
import secrets
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from eldir.errors import EldirError

SHARED = Path("/var/lib/eldir")
"""An administrator makes it: owned by root, mode 2770, its group drives the rigs of this computer."""
_LARGEST = 65_536  # of a file [bytes]
_MOST = 1024  # entries
_PATIENCE, _POLL = 0.2, 0.002  # with a program that changes files [s]: a stop must go on
_OPEN = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY


class StateError(EldirError):
    """The folder, or a file in it, cannot be trusted."""

    code = "state"


class StateFolder:
    """Files of one folder, read and written by name."""

    def __init__(self, handle: int, path: Path, shared: bool):
        self._handle, self.path, self._shared = handle, path, shared

    def names(self) -> list[str]:
        """Names of its entries. Raises `StateError` if there are too many."""
        found = []
        with os.scandir(self._handle) as entries:
            for entry in entries:
                found.append(entry.name)
                if len(found) > _MOST:
                    raise StateError(
                        f"{self.path} has too many files",
                        code="state.too-many-files",
                        remedy="look at it and empty it",
                    )
        return sorted(found)

    def read(self, name: str) -> bytes:
        """Contents of a file. Raises `StateError` for anything but a small regular file of its own users, and
        `FileNotFoundError`."""
        try:
            handle = os.open(name, os.O_RDONLY | _OPEN, dir_fd=self._handle)
        except FileNotFoundError:
            raise
        except OSError as error:
            raise self._wrong(name, error.strerror or str(error)) from None
        try:
            status = os.fstat(handle)
            if not stat.S_ISREG(status.st_mode):
                raise self._wrong(name, "it is not a regular file")
            if not self._shared and status.st_uid not in (os.geteuid(), 0):
                raise self._wrong(name, f"it belongs to user {status.st_uid}")
            if status.st_mode & (stat.S_IWOTH if self._shared else stat.S_IWOTH | stat.S_IWGRP):
                raise self._wrong(name, "other users can write it")
            if status.st_size > _LARGEST:
                raise self._wrong(name, f"it has {status.st_size} bytes")
            return os.read(handle, _LARGEST)
        except OSError as error:
            raise self._wrong(name, error.strerror or str(error)) from None
        finally:
            os.close(handle)

    def write(self, name: str, data: bytes) -> None:
        """Replace a file; it survives a loss of power. Raises `OSError`; then the old file is still there."""
        draft = f".{name}.{secrets.token_hex(8)}"
        mode = 0o660 if self._shared else 0o600
        handle = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _OPEN, mode, dir_fd=self._handle)
        try:
            with os.fdopen(handle, "wb") as file:
                os.fchmod(handle, mode)
                file.write(data)
                file.flush()
                os.fsync(handle)
            os.replace(draft, name, src_dir_fd=self._handle, dst_dir_fd=self._handle)
        except BaseException:
            with suppress(OSError):
                os.unlink(draft, dir_fd=self._handle)
            raise
        os.fsync(self._handle)

    def remove(self, name: str) -> None:
        """Remove a file, or a link itself."""
        with suppress(FileNotFoundError):
            os.unlink(name, dir_fd=self._handle)
        os.fsync(self._handle)

    def _wrong(self, name: str, why: str) -> StateError:
        return StateError(f"{self.path / name} cannot be trusted: {why}", code="state.untrusted")


@contextmanager
def state_folder(shared: Path = SHARED, *, alone: bool = False) -> Iterator[StateFolder]:
    """Open the folder; that of the user is created if needed. Raises `StateError` for an unsafe one.

    `alone`: to change a file by what it says. Other programs that do so wait, a fifth of a second at most.
    """
    common = os.path.lexists(shared)
    path = shared if common else _own_path()
    if not common:
        _create(path)
    try:
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        remedy = "ask to be in its group" if common else "make it a folder of your own with mode 700"
        raise StateError(
            f"cannot open {path}: {error.strerror}", code="state.no-access", remedy=remedy
        ) from None
    try:
        _check(os.fstat(handle), path, common)
        if alone:
            _lock(handle)
        yield StateFolder(handle, path, common)
    finally:
        os.close(handle)


def _lock(folder: int) -> None:
    """Wait until no other program holds the lock, and hold it until the folder is closed."""
    begun = time.monotonic()
    while time.monotonic() - begun < _PATIENCE:
        try:
            return fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_POLL)
        except OSError:  # a file system without locks
            return None
    return None


def _own_path() -> Path:
    """The same from every terminal: the home of the account, not of the environment."""
    base = os.environ.get("XDG_STATE_HOME", "")
    if os.path.isabs(base):
        return Path(base) / "eldir"
    try:
        home = pwd.getpwuid(os.geteuid()).pw_dir
    except KeyError:
        home = os.environ.get("HOME", "/")
    return Path(home) / ".local" / "state" / "eldir"


def _create(path: Path) -> None:
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with suppress(FileExistsError):
            path.mkdir(mode=0o700)
        above = path.parent.stat().st_mode
    except OSError as error:
        raise StateError(
            f"cannot make {path}: {error.strerror}",
            code="state.no-access",
            remedy="set XDG_STATE_HOME to a folder of your own",
        ) from None
    if above & stat.S_IWOTH and not above & stat.S_ISVTX:
        raise StateError(
            f"{path.parent} can be written by every user",
            code="state.open-folder",
            remedy=f"chmod o-w {path.parent}, or set XDG_STATE_HOME",
        )


def _check(status: os.stat_result, path: Path, common: bool) -> None:
    mode = stat.S_IMODE(status.st_mode)
    if not common:
        if status.st_uid != os.geteuid():
            raise StateError(
                f"{path} belongs to user {status.st_uid}",
                code="state.open-folder",
                expected=f"user {os.geteuid()}",
                remedy="remove it, or set XDG_STATE_HOME to a folder of your own",
            )
        if mode & 0o022:
            raise StateError(
                f"other users can write {path}",
                code="state.open-folder",
                found=f"mode {mode:o}",
                remedy=f"chmod 700 {path}",
            )
        return
    if status.st_uid != 0 or mode & stat.S_IWOTH or not mode & stat.S_IWGRP:
        raise StateError(
            f"{path} is not safe to share",
            code="state.open-folder",
            expected="owner root, mode 2770, the group that drives rigs",
            found=f"owner {status.st_uid}, mode {mode:o}",
            remedy=f"as root: chown root:GROUP {path}; chmod 2770 {path}; or remove it",
        )
    if not os.access(path, os.W_OK | os.X_OK):
        raise StateError(
            f"{path} may not be written", code="state.no-access", remedy="ask to be in its group"
        )
