"""The boards that `eldir rig off` must reach: by the file, the option, the records and the kernel's locks.

A name may stand for two: the device of a run that was begun through it, and the one that it names now.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from eldir.errors import InputError
from eldir_hardware.relay.registration import board_of, kinds
from eldir_hardware.rig.board_hints import BoardHints, port_problem, read_board_hints
from eldir_hardware.rig.board_identity import BoardIdentity, identify, is_gone_pseudo_terminal, locate, moved
from eldir_hardware.rig.port_holder import Guarded, guarded_ports, lock_of
from eldir_hardware.safety.latch import BoardRecord, read_records
from eldir_hardware.safety.state_folder import SHARED, StateError

_PORT = "a serial port, such as /dev/serial/by-path/..."


@dataclass
class Target:
    """A device, and what its board may be."""

    port: str
    """Its name for the user."""
    candidates: list[tuple[str, int | None]] = field(default_factory=list)
    """Kinds with their numbers of channels, the most credible first; empty if nothing tells it."""
    record: BoardRecord | None = None
    """The record of this very device."""
    at: BoardIdentity | None = None

    @property
    def device(self) -> BoardIdentity:
        """What is switched off, whatever its name stands for by now."""
        return identify(self.port) if self.at is None else self.at

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
    told = BoardHints() if rig_file is None else read_board_hints(rig_file)
    named, problems = _named_ports(port, told)
    if told.virtual and not told.ports and port is None:
        raise InputError(
            f"{rig_file} is a virtual rig: it has no port and heats nothing",
            code="rig.virtual",
            expected="kind: real",
        )
    remarks = [*([told.problem] if told.problem else []), *problems]
    try:
        records, wrong = read_records(shared)
        remarks += wrong.values()
    except StateError as error:
        records = {}
        remarks.append(str(error))
    guarded = guarded_ports()
    driven = [r for r in records.values() if not is_gone_pseudo_terminal(r.identity)]
    targets: dict[str, Target] = {}
    for name in named:
        runs = _runs_through(name, guarded, driven)
        remarks += dict.fromkeys(filter(None, (moved(name, device) for device in runs)))
        _add(targets, name, [*runs, *([identify(name)] if os.path.exists(name) or not runs else [])])
    of_file = list(targets.values())
    if not named:
        remarks.append("switching off every port that this computer drives")
        for guardian in guarded:
            _add(targets, guardian.named, [_held(guardian, driven)])
    if port is None:  # the file may name another port than the one through which its rig was driven
        for record in driven:
            if not named or told.name in (record.rig, None):
                _add(targets, record.port, [record.identity])
    for target in targets.values():
        target.may_be(board, told.channels)
        _recognise(target, guarded, records)
        for kind in told.kinds if target in of_file else ():
            target.may_be(kind, told.channels)
    left = {os.path.realpath(g.port) for g in guarded} - targets.keys()
    remarks += [f"{p} is driven too: eldir rig off --port {p}" for p in sorted(left)]
    return list(targets.values()), remarks


def _named_ports(port: str | None, told: BoardHints) -> tuple[list[str], list[str]]:
    """The port of the command or those of the rig file, and what is wrong with others of the file.

    Raises `InputError` for the command's.
    """
    if port is None:
        problems = [f"{problem}; expected {_PORT}" for p in told.ports if (problem := port_problem(p))]
        return [p for p in told.ports if not port_problem(p)], problems
    if problem := port_problem(port):
        raise InputError(problem, expected=_PORT, remedy="correct --port, or leave it out: every known board")
    return [port], []


def _runs_through(name: str, guarded: list[Guarded], driven: list[BoardRecord]) -> list[BoardIdentity]:
    """Devices of the runs that were begun through this name, or that drive what it names now."""
    given, now, here = os.path.abspath(name), os.path.realpath(name), identify(name)
    held = [_held(g, driven) for g in guarded if given in (g.named, g.port) or now == g.port]
    return held + [
        r.identity for r in driven if os.path.abspath(r.port) == given or r.identity.same_board(here)
    ]


def _held(guardian: Guarded, driven: list[BoardRecord]) -> BoardIdentity:
    """The device whose lock a guardian holds; it may have been unplugged."""
    if lock_of(guardian.port) == guardian.lock:
        return identify(guardian.port)
    known = (r.identity for r in driven if r.identity.name == guardian.port)
    unknown = BoardIdentity(guardian.port, frozenset({f"lock:{guardian.lock}"}))
    return replace(next(known, unknown), lock=guardian.lock)


def _add(targets: dict[str, Target], name: str, devices: Iterable[BoardIdentity]) -> None:
    """Add devices that a name stands or stood for, each once, by the place where it is now."""
    for device in devices:
        where = locate(device)
        shown = name if os.path.realpath(name) == where else where or device.name
        targets.setdefault(where or f"{device.name} {sorted(device.hardware)}", Target(shown, at=device))


def _recognise(target: Target, guarded: list[Guarded], records: Mapping[str, BoardRecord]) -> None:
    """What a guardian's command line and the records say about a device."""
    lock = lock_of(target.device)
    for guardian in guarded:
        if guardian.lock == lock:
            target.may_be(guardian.kind, guardian.channels)
    for record in records.values():
        if record.identity.same_device(target.device):
            target.record = record
        if record.identity.same_board(target.device):
            target.may_be(record.kind, record.channels)
