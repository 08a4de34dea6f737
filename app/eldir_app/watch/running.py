"""What is driven on this computer now: the kernel's locks name the guardians, and they lead to the logs.

The program that plays writes its log itself, but for a ROS 2 graph: there the guardian belongs to the node of
the board, and the recorder is another process. Then the log counts that has a rig of the same name.
`rig_state` says how guardian, latch and disk are.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from eldir.core.yaml_files import parse_yaml
from eldir.errors import EldirError
from eldir_hardware.log.following import LogFollower
from eldir_hardware.rig.board_hints import read_board_hints
from eldir_hardware.rig.port_holder import guarded_ports
from eldir_hardware.run.orders import takes_orders
from eldir_hardware.safety.latch import DIED, read_records, record_of, stop_of
from eldir_hardware.safety.state_folder import StateError

_PROC = Path("/proc")
_WRITING = os.O_WRONLY | os.O_RDWR
_BEGINNING = 200  # messages of a log before which it must hold its rig file


class Driven(NamedTuple):
    """A port that a guardian holds."""

    port: str
    guardian: int
    """Process number."""
    player: int
    """Process that plays, the guardian's parent."""
    logs: tuple[Path, ...]
    """Logs of it that are written now."""
    takes_orders: bool
    """Whether the player obeys pause, resume, step and finish."""
    named: str = ""
    """The name by which the port was given: a link may stand for another device by now."""


def driven_ports() -> list[Driven]:
    """Every port that is driven now, as far as this user may see it."""
    found = []
    for guarded in guarded_ports():
        player = parent_of(guarded.process)
        if player is not None:
            logs = tuple(_logs_of(player)) or tuple(_recorded_elsewhere(guarded.port))
            orders = takes_orders(player)
            found.append(Driven(guarded.port, guarded.process, player, logs, orders, guarded.named))
    return found


def driven_through(rig_file: Path) -> list[Driven]:
    """Those of a rig: through its port, or with its name in the records of the boards."""
    told = read_board_hints(rig_file)
    named = {at for p in told.ports for at in (os.path.abspath(p), os.path.realpath(p))}
    if told.virtual and not named:  # its port is another one in each run
        named = {port for port, rig in _rigs().items() if rig == told.name}
    return [d for d in driven_ports() if d.port in named or d.named in named]


def driven_into(log: Path) -> list[Driven]:
    """Those whose run is written into a log."""
    log = log.resolve()
    return [d for d in driven_ports() if log in d.logs]


def _is_suspended(process: int) -> bool:
    """Whether a process stands still, as after SIGSTOP."""
    with suppress(OSError, IndexError):
        return _fields(process)[0] in "Tt"
    return False


def parent_of(process: int) -> int | None:
    """The process that started another one."""
    with suppress(OSError, IndexError, ValueError):
        return int(_fields(process)[1])
    return None


def _rigs() -> dict[str, str | None]:
    """Name of the rig behind each port that is or was driven, from the records of the boards."""
    with suppress(StateError):
        records, _ = read_records()
        return {r.identity.name: r.rig for r in records.values()}
    return {}


def _recorded_elsewhere(port: str) -> Iterator[Path]:
    """Logs with this port's rig that any process of this user writes."""
    rig = None
    with suppress(StateError):
        record = record_of(port)
        rig = None if record is None else record.rig
    if rig is not None:
        written = {log for p in _PROC.iterdir() if p.name.isdigit() for log in _logs_of(int(p.name))}
        yield from sorted(log for log in written if _rig_in(log) == rig)


def _rig_in(path: Path) -> str | None:
    """Name of the rig whose file is kept at the beginning of a log; None as long as it is not there."""
    with suppress(EldirError, OSError, KeyError, TypeError), LogFollower(path) as log:
        for number, _ in enumerate(log.poll()):
            if "rig.yaml" in log.attachments or number > _BEGINNING:
                break
        return str(parse_yaml(log.attachments["rig.yaml"], str(path))["name"])
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


def rig_state(driven: Sequence[Driven], ports: Sequence[str], folder: Path | None) -> dict[str, Any]:
    """Guardian, player, latch and disk, as the page shows them, in plain values.

    `ports` are those whose latch counts, `folder` is where the log is."""
    return {
        "guardian": _guardian(driven),
        "player": _player(driven),
        "latch": _latch([*ports, *(d.port for d in driven)], bool(driven)),
        "free_mb": _free(folder),
    }


def _guardian(driven: Sequence[Driven]) -> list[Any]:
    """Whether all is well, and a text."""
    if not driven:
        return [None, "no port is driven"]
    hung = [d.port for d in driven if _is_suspended(d.guardian)]
    if hung:
        return [False, f"suspended at {', '.join(hung)}"]
    return [True, f"holds {', '.join(d.port for d in driven)}"]


def _player(driven: Sequence[Driven]) -> list[Any]:
    if not driven:
        return [None, "does not run"]
    if any(_is_suspended(d.player) for d in driven):
        return [False, "suspended"]
    return [True, "runs"]


def _latch(ports: Sequence[str], driven: bool) -> list[Any]:
    for port in dict.fromkeys(ports):  # a link too: it counts for stops of runs through it
        try:
            why = stop_of(port)
        except StateError as error:
            return [False, f"counts as stopped: {error}"]
        if why is not None and not (driven and why == DIED):
            return [False, f"stopped: {why}"]
    return [True if ports else None, "not latched" if ports else "no board"]


def _free(folder: Path | None) -> int | None:
    with suppress(OSError):
        return None if folder is None else shutil.disk_usage(folder).free // 1_000_000
    return None
