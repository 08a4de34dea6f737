"""How the guardian's process is started: it runs no code of the working directory or of the environment."""

from __future__ import annotations

import os
import stat
import sys
from contextlib import suppress
from pathlib import Path

from eldir import errors
from eldir_hardware.rig.port_holder import GUARDIAN

# -I: neither the working directory, PYTHON* variables such as PYTHONPATH, nor the user's site-packages count.
# What only this program has on its import path, such as boards in a folder of packages, comes last.
_BOOT = "import sys; sys.path += sys.argv[7:]; from eldir_hardware.guardian.process import main; main()"
_KEPT = ("ELDIR_LOG", "HOME", "LANG", "LOGNAME", "PATH", "TZ", "USER", "XDG_STATE_HOME")


def guardian_command(socket: int, port: str, kind: str, channels: int, named: str) -> list[str]:
    """The command line. `eldir rig off` reads the device, the kind of board, its channels, and the name by
    which the device was given there."""
    words = [GUARDIAN, str(socket), port, kind, str(channels), named]
    return [sys.executable, "-I", "-c", _BOOT, *words, *import_path()]


def import_path() -> list[str]:
    """Folders of this program's import path, without the working directory and what every user can write."""
    homes = [str(Path(errors.__file__).parents[1]), str(Path(__file__).parents[2])]
    return [p for p in dict.fromkeys([*sys.path, *homes]) if _is_safe(p) and (p in homes or not _is_here(p))]


def clean_environment() -> dict[str, str]:
    """The few variables that the guardian needs."""
    kept = {n: v for n, v in os.environ.items() if n in _KEPT or n.startswith("LC_")}
    # A Python that was built with shared libraries may need its folders.
    libraries = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    if safe := [p for p in libraries if _is_safe(p) and not _is_here(p)]:
        kept["LD_LIBRARY_PATH"] = os.pathsep.join(safe)
    kept["PYDANTIC_DISABLE_PLUGINS"] = "__all__"  # code of other packages, looked for in every one of them
    return kept


def _is_safe(folder: str) -> bool:
    with suppress(OSError, ValueError):
        status = os.stat(folder)
        return os.path.isabs(folder) and stat.S_ISDIR(status.st_mode) and not status.st_mode & stat.S_IWOTH
    return False


def _is_here(folder: str) -> bool:
    return os.path.realpath(folder) == os.getcwd()
