"""The guardian's process as seen by the program that starts it: command line, environment, messages.

The process runs no code of the working directory or of the environment. Messages are JSON, one packet each,
on a pair of local sockets.
"""

from __future__ import annotations

import json
import os
import socket
import stat
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from eldir import errors
from eldir_hardware.rig.port_holder import GUARDIAN_WORD

# -I: neither the working directory, PYTHON* variables such as PYTHONPATH, nor the user's site-packages count.
# Folders that only this program has on its import path, such as those with boards, come last.
_BOOT_CODE = "import sys; sys.path += sys.argv[7:]; from eldir_hardware.guardian._process import main; main()"
_PASSED_ON = ("ELDIR_LOG", "HOME", "LANG", "LOGNAME", "PATH", "TZ", "USER", "XDG_STATE_HOME")
MAX_MESSAGE = 1 << 16
"""Longest message [bytes]; a rig of sixteen channels needs a twentieth."""


def guardian_command(socket: int, port: str, kind: str, channels: int, given_name: str) -> list[str]:
    """The command line, in which `eldir rig off` reads device, kind of board, channels, and given name."""
    words = [GUARDIAN_WORD, str(socket), port, kind, str(channels), given_name]
    return [sys.executable, "-I", "-c", _BOOT_CODE, *words, *import_path()]


def import_path() -> list[str]:
    """This program's import path without the working directory and folders that every user can write."""
    own_folders = [str(Path(errors.__file__).parents[1]), str(Path(__file__).parents[2])]
    return [
        p
        for p in dict.fromkeys([*sys.path, *own_folders])
        if _is_safe(p) and (p in own_folders or not _is_working_directory(p))
    ]


def clean_environment() -> dict[str, str]:
    """The environment variables that the guardian needs."""
    passed_on = {n: v for n, v in os.environ.items() if n in _PASSED_ON or n.startswith("LC_")}
    # A Python that was built with shared libraries may need its folders.
    libraries = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    if safe := [p for p in libraries if _is_safe(p) and not _is_working_directory(p)]:
        passed_on["LD_LIBRARY_PATH"] = os.pathsep.join(safe)
    passed_on["PYDANTIC_DISABLE_PLUGINS"] = "__all__"  # plug-ins of other packages, which take long to find
    passed_on["OPENBLAS_NUM_THREADS"] = "1"  # others take long to start, and the guardian needs none
    return passed_on


def _is_safe(folder: str) -> bool:
    with suppress(OSError, ValueError):
        status = os.stat(folder)
        return os.path.isabs(folder) and stat.S_ISDIR(status.st_mode) and not status.st_mode & stat.S_IWOTH
    return False


def _is_working_directory(folder: str) -> bool:
    return os.path.realpath(folder) == os.getcwd()


class GuardianConnection:
    """One end of the connection. It never blocks: a message that the other end does not accept is dropped."""

    def __init__(self, end: socket.socket):
        self._end = end
        end.setblocking(False)

    @staticmethod
    def fits(**message: Any) -> bool:
        """Whether a message can be sent."""
        return len(json.dumps(message).encode()) < MAX_MESSAGE

    def fileno(self) -> int:
        """File descriptor, for `select`."""
        return self._end.fileno()

    def send(self, **message: Any) -> bool:
        """Send a message, and return whether the other end accepted it."""
        with suppress(OSError):
            self._end.send(json.dumps(message).encode())
            return True
        return False

    def receive(self) -> list[dict[str, Any]] | None:
        """Messages received since the last call; None after the other end has closed or died."""
        messages: list[dict[str, Any]] = []
        reset = False
        while True:
            try:
                packet = self._end.recv(MAX_MESSAGE)
            except BlockingIOError:
                return messages
            except ConnectionResetError:  # raised once, before the last messages of the other end
                if not reset:
                    reset = True
                    continue
                packet = b""
            except OSError:
                packet = b""
            if not packet:
                return messages or None
            messages.append(json.loads(packet))

    def close(self) -> None:
        """Close this end."""
        self._end.close()
