"""The folder of latched stops, which other users cannot write.

/var/lib/eldir if an administrator made it for a group; otherwise this user's $XDG_STATE_HOME/eldir or
~/.local/state/eldir. No file is opened through a link, and no file that others can write is trusted.
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

SHARED_FOLDER = Path("/var/lib/eldir")
"""Made by an administrator: owned by root, mode 2770, and the group that drives rigs here."""
_MAX_BYTES = 65_536  # of a file [bytes]
_MAX_ENTRIES = 1024
_LOCK_TIMEOUT = 0.2  # [s]; a stop must not wait longer for another program
_POLL_INTERVAL = 0.002  # [s]
_OPEN = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY


class StateError(EldirError):
    """The folder, or a file in it, cannot be trusted."""

    code = "state"


class StateFolder:
    """Files of one folder, read and written by name."""

    def __init__(self, handle: int, path: Path, shared: bool):
        self._handle, self.path, self._shared = handle, path, shared

    def names(self) -> list[str]:
        """Names of the entries. Raises `StateError` if there are too many."""
        names = []
        with os.scandir(self._handle) as entries:
            for entry in entries:
                names.append(entry.name)
                if len(names) > _MAX_ENTRIES:
                    raise StateError(
                        f"{self.path} has too many files",
                        code="state.too-many-files",
                        remedy="look at it and empty it",
                    )
        return sorted(names)

    def read(self, name: str) -> bytes:
        """Contents of a file. Raises `StateError` unless it is a small regular file of permitted users, and
        `FileNotFoundError`."""
        try:
            handle = os.open(name, os.O_RDONLY | _OPEN, dir_fd=self._handle)
        except FileNotFoundError:
            raise
        except OSError as error:
            raise self._untrusted_error(name, error.strerror or str(error)) from None
        try:
            status = os.fstat(handle)
            if not stat.S_ISREG(status.st_mode):
                raise self._untrusted_error(name, "it is not a regular file")
            if not self._shared and status.st_uid not in (os.geteuid(), 0):
                raise self._untrusted_error(name, f"it belongs to user {status.st_uid}")
            if status.st_mode & (stat.S_IWOTH if self._shared else stat.S_IWOTH | stat.S_IWGRP):
                raise self._untrusted_error(name, "other users can write it")
            if status.st_size > _MAX_BYTES:
                raise self._untrusted_error(name, f"it has {status.st_size} bytes")
            return os.read(handle, _MAX_BYTES)
        except OSError as error:
            raise self._untrusted_error(name, error.strerror or str(error)) from None
        finally:
            os.close(handle)

    def write(self, name: str, data: bytes) -> None:
        """Replace a file; it survives a loss of power. Raises `OSError`, and keeps the old file then."""
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

    def _untrusted_error(self, name: str, reason: str) -> StateError:
        return StateError(f"{self.path / name} cannot be trusted: {reason}", code="state.untrusted")


@contextmanager
def open_state_folder(shared: Path = SHARED_FOLDER, *, exclusive: bool = False) -> Iterator[StateFolder]:
    """Open the folder; that of the user is created if needed. Raises `StateError` for an unsafe one.

    `exclusive`: to change a file by its content. Other programs that do so wait, for 0.2 s at most.
    """
    is_shared = os.path.lexists(shared)
    path = shared if is_shared else _user_path()
    if not is_shared:
        _create(path)
    try:
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        remedy = "ask to be in its group" if is_shared else "make it a folder of your own with mode 700"
        raise StateError(
            f"cannot open {path}: {error.strerror}", code="state.no-access", remedy=remedy
        ) from None
    try:
        _check_permissions(os.fstat(handle), path, is_shared)
        if exclusive:
            _lock(handle)
        yield StateFolder(handle, path, is_shared)
    finally:
        os.close(handle)


def _lock(folder: int) -> None:
    """Wait until no other program holds the lock, and hold it until the folder is closed."""
    begun = time.monotonic()
    while time.monotonic() - begun < _LOCK_TIMEOUT:
        try:
            return fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_POLL_INTERVAL)
        except OSError:  # a file system without locks
            return None
    return None


def _user_path() -> Path:
    """The same folder from every terminal: in the home of the account, not of the environment."""
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
        parent_mode = path.parent.stat().st_mode
    except OSError as error:
        raise StateError(
            f"cannot make {path}: {error.strerror}",
            code="state.no-access",
            remedy="set XDG_STATE_HOME to a folder of your own",
        ) from None
    if parent_mode & stat.S_IWOTH and not parent_mode & stat.S_ISVTX:
        raise StateError(
            f"{path.parent} can be written by every user",
            code="state.open-folder",
            remedy=f"chmod o-w {path.parent}, or set XDG_STATE_HOME",
        )


def _check_permissions(status: os.stat_result, path: Path, is_shared: bool) -> None:
    mode = stat.S_IMODE(status.st_mode)
    if not is_shared:
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
