"""Runs in virtual time that this computer plays now: virtual rigs with `clock: virtual`, and rehearsals.

Such a run has neither a port nor a guardian. Its program obeys orders, and the kernel shows the log that it
writes; the log has the rig file.
"""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from eldir.core.yaml_files import parse_yaml
from eldir.errors import EldirError
from eldir_hardware.log.following import LogFollower
from eldir_hardware.log.messages import VIRTUAL_EPOCH
from eldir_hardware.rig._board_hints import read_board_hints
from eldir_hardware.rig.port_holder import list_guarded_ports
from eldir_hardware.run.remote_control import list_players

_PROC = Path("/proc")
_WRITE_FLAGS = os.O_WRONLY | os.O_RDWR
_MAX_MESSAGES_BEFORE_RIG = 200  # a log has its rig file before this message
_END_TIMEOUT_S = 10.0  # of the program, which finishes its log


class VirtualRun(NamedTuple):
    """A run in virtual time. It heats nothing."""

    player: int
    """Process number of the program that plays."""
    log: Path
    """The log that it is writing."""
    rig: bytes
    """The rig file in the log."""


def list_virtual_runs() -> list[VirtualRun]:
    """All runs in virtual time of this user."""
    players = list_players()
    if not players:
        return []
    heating = {parent_of(guarded.process) for guarded in list_guarded_ports()}
    found = []
    for player in players:
        for log in logs_written_by(player) if player not in heating else ():
            with suppress(EldirError, OSError, LookupError):  # it has just begun or ended
                epoch_ns, rig = _read_beginning(log, log.stat().st_ino)
                if epoch_ns == VIRTUAL_EPOCH:
                    found.append(VirtualRun(player, log, rig))
    return found


def virtual_runs_of(rig_file: Path) -> list[VirtualRun]:
    """The runs in virtual time of a virtual rig: those of this very file, or else of its name, as the file
    may have changed since."""
    hints = read_board_hints(rig_file)
    if not hints.is_portless:
        return []
    named = [run for run in list_virtual_runs() if _name_in(run.rig, run.log) == hints.name]
    with suppress(OSError):
        content = rig_file.read_bytes()
        return [run for run in named if run.rig == content] or named
    return named


def end_virtual_run(run: VirtualRun) -> str:
    """End the program of a run, and return a sentence for the user. Raises `EldirError` if it does not
    end."""
    with suppress(ProcessLookupError), os.fdopen(os.pidfd_open(run.player)) as process:
        if run.player not in list_players():  # the number may stand for another program by now
            return f"{run.log.name}: the run has ended"
        signal.pidfd_send_signal(process.fileno(), signal.SIGTERM)
        if not select.select([process], [], [], _END_TIMEOUT_S)[0]:
            raise EldirError(
                f"program {run.player} does not end",
                remedy=f"end it: kill -KILL {run.player}; it heats nothing",
            )
    return f"{run.log.name}: the run was ended; it is in virtual time and heats nothing"


def parent_of(process: int) -> int | None:
    """The process that started another one."""
    with suppress(OSError, IndexError, ValueError):
        return int((_PROC / str(process) / "stat").read_text().rpartition(")")[2].split()[1])
    return None


def logs_written_by(process: int) -> Iterator[Path]:
    """Logs that a process has open for writing."""
    folder = _PROC / str(process) / "fd"
    with suppress(OSError):
        for link in folder.iterdir():
            with suppress(OSError, ValueError, IndexError):
                path = Path(os.readlink(link))
                if path.suffix == ".mcap" and _is_written(process, link.name):
                    yield path


def rig_name_in(log: Path) -> str | None:
    """Name of the rig in the attached rig file of a log; None while there is none yet."""
    with suppress(EldirError, OSError, LookupError):
        return _name_in(_read_beginning(log, log.stat().st_ino)[1], log)
    return None


def _is_written(process: int, handle: str) -> bool:
    text = (_PROC / str(process) / "fdinfo" / handle).read_text()
    flags = text.partition("flags:")[2].split()[0]
    return bool(int(flags, 8) & _WRITE_FLAGS)


@lru_cache(maxsize=64)
def _read_beginning(log: Path, inode: int) -> tuple[int | None, bytes]:
    """Time of day at the start of a log [ns], and its rig file. `inode` tells logs of one name apart. Raises
    `LookupError` while the rig file is not there yet."""
    with LogFollower(log) as followed:
        for number, _ in enumerate(followed.poll()):
            if "rig.yaml" in followed.attachments or number > _MAX_MESSAGES_BEFORE_RIG:
                break
        return followed.epoch_ns, followed.attachments["rig.yaml"]


def _name_in(rig: bytes, log: Path) -> str | None:
    with suppress(EldirError, KeyError, TypeError):
        return str(parse_yaml(rig, str(log))["name"])
    return None
