"""Which rigs are driven on this computer now: locks of the kernel lead to the guardians, and those to the
logs.

A player writes its log itself, except in a ROS 2 graph: there the guardian belongs to the node of the board,
and the recorder is another process. Then the log with the name of the same rig is taken. `rig_state`
describes guardian, player, latch and disk.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from eldir_hardware.rig._board_hints import read_board_hints
from eldir_hardware.rig.port_holder import list_guarded_ports
from eldir_hardware.run.remote_control import accepts_commands
from eldir_hardware.run.virtual_runs import VirtualRun, logs_written_by, parent_of, rig_name_in
from eldir_hardware.safety.latch import GUARDIAN_DIED, find_record, read_records, read_stop
from eldir_hardware.safety.state_folder import StateError

_PROC = Path("/proc")


class DrivenPort(NamedTuple):
    """A port that a guardian holds."""

    port: str
    guardian: int
    """Process number."""
    player: int
    """Process number of the player, the guardian's parent."""
    logs: tuple[Path, ...]
    """Logs that it is writing."""
    accepts_commands: bool
    """Whether the player accepts pause, resume, step and finish."""
    given_name: str = ""
    """The path by which the port was given; a link may point to another device by now."""


def driven_ports() -> list[DrivenPort]:
    """All ports that are driven now, as far as this user may see them."""
    ports = []
    for guarded in list_guarded_ports():
        player = parent_of(guarded.process)
        if player is not None:
            logs = tuple(logs_written_by(player)) or tuple(_logs_of_recorder(guarded.port))
            orders = accepts_commands(player)
            ports.append(DrivenPort(guarded.port, guarded.process, player, logs, orders, guarded.given_name))
    return ports


def ports_of_rig(rig_file: Path) -> list[DrivenPort]:
    """The driven ports of a rig: by its port, or by its name in the records of the boards."""
    hints = read_board_hints(rig_file)
    ports = {path for p in hints.ports for path in (os.path.abspath(p), os.path.realpath(p))}
    if hints.is_portless:  # its port is another one in each run
        ports = {port for port, rig in _rig_names().items() if rig == hints.name}
    return [d for d in driven_ports() if d.port in ports or d.given_name in ports]


def ports_of_log(log: Path) -> list[DrivenPort]:
    """The driven ports whose run is recorded in a log."""
    log = log.resolve()
    return [d for d in driven_ports() if log in d.logs]


def _is_suspended(process: int) -> bool:
    """Whether a process is suspended, such as by SIGSTOP."""
    with suppress(OSError, IndexError):
        return _stat_fields(process)[0] in "Tt"
    return False


def _rig_names() -> dict[str, str | None]:
    """Name of the rig at each port that is or was driven, from the records of the boards."""
    with suppress(StateError):
        records, _ = read_records()
        return {r.identity.name: r.rig for r in records.values()}
    return {}


def _logs_of_recorder(port: str) -> Iterator[Path]:
    """Logs of this port's rig that any process of this user is writing."""
    rig = None
    with suppress(StateError):
        record = find_record(port)
        rig = None if record is None else record.rig
    if rig is not None:
        logs = {log for p in _PROC.iterdir() if p.name.isdigit() for log in logs_written_by(int(p.name))}
        yield from sorted(log for log in logs if rig_name_in(log) == rig)


def _stat_fields(process: int) -> list[str]:
    """State, parent and further fields of /proc/PROCESS/stat."""
    return (_PROC / str(process) / "stat").read_text().rpartition(")")[2].split()


def rig_state(
    driven: Sequence[DrivenPort], virtual: Sequence[VirtualRun], ports: Sequence[str], folder: Path | None
) -> dict[str, Any]:
    """Guardian, player, latch and disk, as the page shows them.

    `virtual`: runs in virtual time. `ports`: further ports whose latch is shown. `folder`: where the log is.
    """
    return {
        "guardian": _guardian_state(driven, virtual),
        "player": _player_state({d.player for d in driven} | {run.player for run in virtual}),
        "latch": _latch_state([*ports, *(d.port for d in driven)], bool(driven)),
        "free_mb": _free_space_mb(folder),
    }


def _guardian_state(driven: Sequence[DrivenPort], virtual: Sequence[VirtualRun]) -> list[Any]:
    """Whether all is well (None: no guardian), and a text."""
    if not driven:
        return [None, "virtual time: nothing is heated" if virtual else "no port is driven"]
    hung = [d.port for d in driven if _is_suspended(d.guardian)]
    if hung:
        return [False, f"suspended at {', '.join(hung)}"]
    return [True, f"holds {', '.join(d.port for d in driven)}"]


def _player_state(players: Collection[int]) -> list[Any]:
    if not players:
        return [None, "not running"]
    if any(_is_suspended(player) for player in players):
        return [False, "suspended"]
    return [True, "running"]


def _latch_state(ports: Sequence[str], driven: bool) -> list[Any]:
    for port in dict.fromkeys(ports):  # links too: a stop may be recorded for the link
        try:
            why = read_stop(port)
        except StateError as error:
            return [False, f"counts as stopped: {error}"]
        if why is not None and not (driven and why == GUARDIAN_DIED):
            return [False, f"stopped: {why}"]
    return [True if ports else None, "not latched" if ports else "no board"]


def _free_space_mb(folder: Path | None) -> int | None:
    with suppress(OSError):
        return None if folder is None else shutil.disk_usage(folder).free // 1_000_000
    return None
