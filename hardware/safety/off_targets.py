"""The boards that `eldir rig off` must reach: by the file, the option, the records and the kernel's locks."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from eldir.errors import InputError
from hardware.relay.registration import board_of, kinds
from hardware.rig.board_identity import identify, is_gone_pseudo_terminal
from hardware.rig.port_holder import Guarded, guarded_ports
from hardware.rig.told import ToldBoard, port_problem, told_by
from hardware.safety.latch import BoardRecord, read_records
from hardware.safety.state_folder import SHARED, StateError

_TTYS = Path("/sys/class/tty")
_PORT = "a serial port, such as /dev/serial/by-path/..."


@dataclass
class Target:
    """A port, and what its board may be."""

    port: str
    candidates: list[tuple[str, int | None]] = field(default_factory=list)
    """Kinds with their numbers of channels, the most credible first; empty if nothing tells it."""
    record: BoardRecord | None = None

    def may_be(self, kind: str | None, channels: int | None) -> None:
        """Add a kind, if it is installed and can be loaded."""
        if kind is None or kind not in kinds():
            return
        with suppress(InputError):
            if channels is not None and not 1 <= channels <= board_of(kind).most_channels:
                channels = None
            if (kind, None) in self.candidates and channels is not None:
                self.candidates[self.candidates.index((kind, None))] = (kind, channels)
            elif channels is not None or kind not in (k for k, _ in self.candidates):
                self.candidates.append((kind, channels))
            self.candidates = list(dict.fromkeys(self.candidates))


def off_targets(
    rig_file: Path | None, port: str | None, board: str | None, shared: Path = SHARED
) -> tuple[list[Target], list[str]]:
    """Ports to switch off, and remarks for the user.

    `board` is a kind. Raises `InputError` for a virtual rig, and for a `board` that is not installed.
    """
    if board is not None:
        board_of(board)
    if port is not None and (problem := port_problem(port)):
        raise InputError(problem, expected=_PORT, remedy="correct --port, or leave it out: every known board")
    told = ToldBoard() if rig_file is None else told_by(rig_file)
    if told.virtual and not told.ports and port is None:
        raise InputError(
            f"{rig_file} is a virtual rig: it has no port and heats nothing", expected="kind: real"
        )
    remarks = [told.problem] if told.problem else []
    try:
        records, wrong = read_records(shared)
        remarks += wrong.values()
    except StateError as error:
        records = {}
        remarks.append(str(error))
    guarded = guarded_ports()
    if port is None:
        remarks += [f"{problem}; expected {_PORT}" for p in told.ports if (problem := port_problem(p))]
    named = [port] if port else [p for p in told.ports if not port_problem(p)]
    driven = [r for r in records.values() if not is_gone_pseudo_terminal(r.identity)]
    if not named:
        remarks.append("switching off every port that this computer drives")
        ports = [*(g.port for g in guarded), *map(_present, driven)]
    elif port is None:  # the file may name another port than the one through which its rig was driven
        ports = [*named, *(_present(r) for r in driven if told.name in (r.rig, None))]
    else:
        ports = named
    targets: dict[str, Target] = {}
    for each in ports:
        targets.setdefault(os.path.realpath(each), Target(each))
    for target in targets.values():
        target.may_be(board, told.channels)
        _recognise(target, guarded, records)
        for kind in told.kinds if target.port in named else ():
            target.may_be(kind, told.channels)
    left = {os.path.realpath(g.port) for g in guarded} - targets.keys()
    remarks += [f"{p} is driven too: eldir rig off --port {p}" for p in sorted(left)]
    return list(targets.values()), remarks


def _recognise(target: Target, guarded: list[Guarded], records: Mapping[str, BoardRecord]) -> None:
    """What a guardian's command line and the records say about a port."""
    name, identity = os.path.realpath(target.port), identify(target.port)
    for guardian in guarded:
        if os.path.realpath(guardian.port) == name:
            target.may_be(guardian.kind, guardian.channels)
    for record in records.values():
        if record.identity.same_board(identity):
            target.record = record
            target.may_be(record.kind, record.channels)


def _present(record: BoardRecord) -> str:
    """The port where the board of a record is now; the recorded one if it is not found."""
    links = [m.removeprefix("link:") for m in record.identity.marks if m.startswith("link:")]
    for port in (record.port, *links, *_ttys()):
        if os.path.exists(port) and record.identity.same_board(identify(port)):
            return port
    return record.port


def _ttys() -> list[str]:
    """Serial ports that have hardware."""
    try:
        return [f"/dev/{tty.name}" for tty in _TTYS.iterdir() if (tty / "device").exists()]
    except OSError:
        return []
