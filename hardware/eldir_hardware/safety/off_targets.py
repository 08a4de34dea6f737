"""The boards that `eldir rig off` must reach: by rig file, option, records and the kernel's locks.

A name may refer to two devices: that of a run which began through it, and the present one.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from eldir.errors import InputError
from eldir_hardware.relay.registration import get_board, installed_kinds
from eldir_hardware.rig._board_hints import BoardHints, find_port_problem, read_board_hints
from eldir_hardware.rig.board_identity import (
    BoardIdentity,
    describe_move,
    identify,
    is_gone_pseudo_terminal,
    locate,
)
from eldir_hardware.rig.port_holder import GuardedPort, get_lock, list_guarded_ports
from eldir_hardware.safety.latch import BoardRecord, read_records
from eldir_hardware.safety.state_folder import SHARED_FOLDER, StateError

_PORT = "a serial port, such as /dev/serial/by-path/..."


@dataclass
class OffTarget:
    """A device, and the kinds of board that it may be."""

    port: str
    """Name of its port for the user."""
    candidates: list[tuple[str, int | None]] = field(default_factory=list)
    """Kinds with their numbers of channels, the most probable first; empty if unknown."""
    record: BoardRecord | None = None
    """The record of this device."""
    at: BoardIdentity | None = None

    @property
    def device(self) -> BoardIdentity:
        """The device to switch off, whatever its name refers to now."""
        return identify(self.port) if self.at is None else self.at

    def add_candidate(self, kind: str | None, channels: int | None) -> None:
        """Add a kind, if it is installed and can be loaded."""
        if kind is None or kind not in installed_kinds():
            return
        with suppress(InputError):
            if channels is not None and not 1 <= channels <= get_board(kind).max_channels:
                channels = None
            if (kind, None) in self.candidates and channels is not None:
                self.candidates[self.candidates.index((kind, None))] = (kind, channels)
            elif channels is not None or kind not in (k for k, _ in self.candidates):
                self.candidates.append((kind, channels))
            self.candidates = list(dict.fromkeys(self.candidates))


def find_off_targets(
    rig_file: Path | None, port: str | None, board: str | None, shared: Path = SHARED_FOLDER
) -> tuple[list[OffTarget], list[str]]:
    """The boards to switch off, and remarks for the user.

    `board` is a kind. A virtual rig has no port in its file: its targets are the ports through which it is
    driven now. Raises `InputError` for a `board` that is not installed.
    """
    if board is not None:
        get_board(board)
    hints = BoardHints() if rig_file is None else read_board_hints(rig_file)
    names, problems = _named_ports(port, hints)
    search = _Search([*([hints.problem] if hints.problem else []), *problems], shared)
    if hints.is_portless and port is None:
        search.add_driven(hints.name)
        for target in search.targets.values():
            search.add_known_kinds(target)
        return list(search.targets.values()), search.remarks
    search.add_named(names)
    from_file = list(search.targets.values())
    if not names:
        search.add_guarded()
    if port is None:  # the file may name another port than the one through which its rig was driven
        search.add_recorded(lambda record: not names or hints.name in (record.rig, None))
    for target in search.targets.values():
        target.add_candidate(board, hints.channels)
        search.add_known_kinds(target)
        for kind in hints.kinds if target in from_file else ():
            target.add_candidate(kind, hints.channels)
    return list(search.targets.values()), [*search.remarks, *search.describe_others()]


class _Search:
    """Collects targets from port names, guardians and records."""

    def __init__(self, remarks: list[str], shared: Path):
        self.remarks = remarks
        self.targets: dict[str, OffTarget] = {}
        """By the present port of the device, or else by its identity."""
        try:
            self._records, problems = read_records(shared)
            self.remarks += problems.values()
        except StateError as error:
            self._records = {}
            self.remarks.append(str(error))
        self._guarded = list_guarded_ports()
        self._driven = [r for r in self._records.values() if not is_gone_pseudo_terminal(r.identity)]

    def add_named(self, names: list[str]) -> None:
        """The devices of runs through these names, and the devices to which the names refer now."""
        for name in names:
            runs = _devices_behind(name, self._guarded, self._driven)
            self.remarks += dict.fromkeys(filter(None, (describe_move(name, device) for device in runs)))
            self._add(name, [*runs, *([identify(name)] if os.path.exists(name) or not runs else [])])

    def add_guarded(self) -> None:
        """The devices of all guardians."""
        self.remarks.append("switching off every port that this computer drives")
        for guardian in self._guarded:
            self._add(guardian.given_name, [_held_device(guardian, self._driven)])

    def add_driven(self, rig: str | None) -> None:
        """The devices that guardians hold now for a rig of this name."""
        held = {guardian.lock for guardian in self._guarded}
        self.add_recorded(lambda record: record.rig == rig and get_lock(record.identity) in held)

    def add_recorded(self, is_meant: Callable[[BoardRecord], bool]) -> None:
        """The devices of the records that are meant."""
        for record in self._driven:
            if is_meant(record):
                self._add(record.port, [record.identity])

    def add_known_kinds(self, target: OffTarget) -> None:
        """Add the kinds that guardians' command lines and records name for a device."""
        lock = get_lock(target.device)
        for guardian in self._guarded:
            if guardian.lock == lock:
                target.add_candidate(guardian.kind, guardian.channels)
        for record in self._records.values():
            if record.identity.is_same_device(target.device):
                target.record = record
            if record.identity.is_same_board(target.device):
                target.add_candidate(record.kind, record.channels)

    def describe_others(self) -> list[str]:
        """Remarks on driven ports that are no targets."""
        others = {os.path.realpath(g.port) for g in self._guarded} - self.targets.keys()
        return [f"{p} is driven too: eldir rig off --port {p}" for p in sorted(others)]

    def _add(self, name: str, devices: Iterable[BoardIdentity]) -> None:
        """Add each device to which a name refers or referred."""
        for device in devices:
            port = locate(device)
            shown = name if os.path.realpath(name) == port else port or device.name
            key = port or f"{device.name} {sorted(device.hardware)}"
            self.targets.setdefault(key, OffTarget(shown, at=device))


def _named_ports(port: str | None, hints: BoardHints) -> tuple[list[str], list[str]]:
    """The port of the command or those of the rig file, and problems of other ports of the file.

    Raises `InputError` for an invalid port of the command.
    """
    if port is None:
        problems = [f"{problem}; expected {_PORT}" for p in hints.ports if (problem := find_port_problem(p))]
        return [p for p in hints.ports if not find_port_problem(p)], problems
    if problem := find_port_problem(port):
        remedy = "correct --port, or leave it out to switch off every known board"
        raise InputError(problem, expected=_PORT, remedy=remedy)
    return [port], []


def _devices_behind(name: str, guarded: list[GuardedPort], driven: list[BoardRecord]) -> list[BoardIdentity]:
    """Devices of the runs that began through this name, or that drive its present device."""
    given, present, here = os.path.abspath(name), os.path.realpath(name), identify(name)
    held = [_held_device(g, driven) for g in guarded if given in (g.given_name, g.port) or present == g.port]
    return held + [
        r.identity for r in driven if os.path.abspath(r.port) == given or r.identity.is_same_board(here)
    ]


def _held_device(guardian: GuardedPort, driven: list[BoardRecord]) -> BoardIdentity:
    """The device whose lock a guardian holds; it may have been unplugged."""
    if get_lock(guardian.port) == guardian.lock:
        return identify(guardian.port)
    known = (r.identity for r in driven if r.identity.name == guardian.port)
    unknown = BoardIdentity(guardian.port, frozenset({f"lock:{guardian.lock}"}))
    return replace(next(known, unknown), lock=guardian.lock)
