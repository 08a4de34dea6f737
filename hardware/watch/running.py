"""What is driven on this computer now: the kernel's locks name the guardians, and they lead to the logs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from hardware.rig.port_holder import guarded_ports
from hardware.rig.told import told_by
from hardware.safety.latch import read_records
from hardware.safety.state_folder import StateError

_PROC = Path("/proc")
_WRITING = os.O_WRONLY | os.O_RDWR


class Driven(NamedTuple):
    """A port that a guardian holds."""

    port: str
    guardian: int
    """Process number."""
    player: int
    """Process that plays, the guardian's parent."""
    logs: tuple[Path, ...]
    """Logs that it writes now."""


def driven_ports() -> list[Driven]:
    """Every port that is driven now, as far as this user may see it."""
    found = []
    for guarded in guarded_ports():
        player = parent_of(guarded.process)
        if player is not None:
            found.append(Driven(guarded.port, guarded.process, player, tuple(_logs_of(player))))
    return found


def driven_through(rig_file: Path) -> list[Driven]:
    """Those of a rig: through its port, or with its name in the records of the boards."""
    told = told_by(rig_file)
    named = {os.path.realpath(p) for p in told.ports}
    if told.virtual and not named:  # its port is another one in each run
        with suppress(StateError):
            records, _ = read_records()
            named = {os.path.realpath(r.port) for r in records.values() if r.rig == told.name}
    return [d for d in driven_ports() if os.path.realpath(d.port) in named]


def driven_into(log: Path) -> list[Driven]:
    """Those whose run is written into a log."""
    log = log.resolve()
    return [d for d in driven_ports() if log in d.logs]


def is_suspended(process: int) -> bool:
    """Whether a process stands still, as after SIGSTOP."""
    with suppress(OSError, IndexError):
        return _fields(process)[0] in "Tt"
    return False


def parent_of(process: int) -> int | None:
    """The process that started another one."""
    with suppress(OSError, IndexError, ValueError):
        return int(_fields(process)[1])
    return None


def _fields(process: int) -> list[str]:
    """State, parent and more of a process."""
    return (_PROC / str(process) / "stat").read_text().rpartition(")")[2].split()


def _logs_of(process: int) -> Iterator[Path]:
    folder = _PROC / str(process) / "fd"
    with suppress(OSError):
        for link in folder.iterdir():
            with suppress(OSError, ValueError, IndexError):
                path = Path(os.readlink(link))
                if path.suffix == ".mcap" and _is_written(process, link.name):
                    yield path


def _is_written(process: int, handle: str) -> bool:
    text = (_PROC / str(process) / "fdinfo" / handle).read_text()
    flags = text.partition("flags:")[2].split()[0]
    return bool(int(flags, 8) & _WRITING)
