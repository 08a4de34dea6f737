"""The latched emergency stop of a board: a record that outlives programs and reboots until it is reset.

The record names the board by what stays when USB renumbers, and its kind, so that `eldir rig off` needs no
rig file. It is written before the first contact closes, and removed after a normal end. A stop counts for
every board with which it shares a mark, such as a link; only the device itself proves its contacts open.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from eldir.errors import EldirError
from eldir_hardware.rig.board_identity import (
    BoardIdentity,
    Port,
    describe_move,
    identify,
    is_gone_pseudo_terminal,
    is_pseudo_terminal,
)
from eldir_hardware.safety.state_folder import SHARED_FOLDER, StateError, StateFolder, open_state_folder

_logger = logging.getLogger(__name__)

FORMAT = "eldir-board/1"
_RECORD_PREFIX = "board-"
SPRINGS_PREFIX = "springs-"
"""Prefix of the files of `eldir_hardware.safety.spring_memory`, which are no stops."""
DAMAGE_ERRORS = (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError)
"""Errors caused by the values of a damaged file."""
GUARDIAN_DIED = "the guardian that drove it died"
"""The reason in the record while the board is driven; it remains if the guardian dies."""


class LatchedError(EldirError):
    """Heating is refused until the stop is reset."""

    code = "stop.latched"


@dataclass(frozen=True)  # not pydantic's, whose import would delay an emergency stop
class BoardRecord:
    """The record of a board that is driven or stopped."""

    identity: BoardIdentity
    """Identity of the board."""
    port: str
    """Name of the port through which it was driven."""
    stop: str
    """Reason of the stop; while the board is driven, that its guardian died."""
    since: str
    """Time of the stop, or of the start of driving (ISO 8601)."""
    kind: str | None = None
    """Kind of the relay board; null if unknown."""
    channels: int | None = None
    """Number of relay channels of the board; null if unknown."""
    rig: str | None = None
    """Name of the rig in its rig file; null if unknown."""
    opened: float | None = None
    """When every contact was last proven open, since the computer started [s]; null if it was not."""
    sensor: BoardIdentity | None = None
    """Current sensor of the run, the only one whose measurement counts for it; null without one."""
    sensor_entries: dict[str, Any] | None = None
    """Entries of the rig file with which that sensor measures, also without the file; null if unknown."""


def uptime() -> float:
    """Time since the computer started, including suspension [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def require_unlatched(port: Port, shared: Path = SHARED_FOLDER) -> None:
    """Raise `LatchedError` if a stop of the board at `port` was not reset, or if this is unknown."""
    try:
        found, problems = read_records(shared)
    except StateError as error:
        raise LatchedError(f"{port} counts as stopped: {error}") from None
    identity = identify(port)
    for record in found.values():
        if record.identity.is_same_board(identity):
            where = describe_move(str(port), record.identity)
            raise latched_error(port, f"{record.stop}{f'; {where}' if where else ''}")
    for problem in problems.values():
        raise LatchedError(
            f"{port} counts as stopped: {problem}",
            remedy="look at the rig, remove that file, then: eldir rig off",
        )


def latch_for_driving(
    port: Port,
    kind: str,
    channels: int,
    rig: str,
    shared: Path = SHARED_FOLDER,
    sensor: BoardIdentity | None = None,
    sensor_entries: dict[str, Any] | None = None,
) -> None:
    """Record the board before it is driven, so that a guardian that dies leaves a stop behind.

    Raises `LatchedError` for a stop since `require_unlatched`, which is kept, and `EldirError`.
    """
    identity = identify(port)
    record = BoardRecord(
        identity,
        str(port),
        GUARDIAN_DIED,
        _now(),
        kind,
        channels,
        rig,
        sensor=sensor,
        sensor_entries=sensor_entries,
    )
    try:
        with open_state_folder(shared, exclusive=True) as folder:
            remove_vanished(folder)
            for other in _read_all(folder)[0].values():
                if other.stop != GUARDIAN_DIED and other.identity.is_same_board(identity):
                    raise latched_error(port, other.stop)
            _write_record(folder, record_file_name(identity), record)
    except (OSError, StateError) as error:
        raise EldirError(
            f"cannot write the record of {port}: {error}",
            code="state.not-written",
            remedy="free disk space or repair that folder: the emergency stop needs it",
        ) from None


def latch(port: Port, why: str, *, opened: bool = False, shared: Path = SHARED_FOLDER) -> str | None:
    """Latch a stop; the first reason is kept. `opened`: every contact of this device was just proven open.

    It raises nothing: if writing fails (a full disk) the record of `latch_for_driving` remains. Returns the
    problem.
    """
    try:
        identity, when = identify(port), uptime() if opened else None
        with open_state_folder(shared, exclusive=True) as folder:
            found, _ = _read_all(folder)
            own = {n: r for n, r in found.items() if r.identity.is_same_device(identity)}
            if not own and (identity.marks or not is_pseudo_terminal(identity)):
                own[record_file_name(identity)] = BoardRecord(identity, str(port), GUARDIAN_DIED, _now())
            for name, record in own.items():
                reason = " ".join(why.split()) if record.stop == GUARDIAN_DIED else record.stop
                _write_record(
                    folder, name, replace(record, stop=reason, since=_now(), opened=when or record.opened)
                )
    except (OSError, StateError) as error:
        return str(error)
    _logger.info("latched the stop of %s: %s", port, why)
    return None


def require_not_stopped(port: Port, shared: Path = SHARED_FOLDER) -> None:
    """Raise `LatchedError` if another user has stopped a board while it is driven.

    `eldir rig off` cannot signal another user's guardian, and between two pulses its frames have no effect.
    Only a shared folder shows the stop.
    """
    if os.path.lexists(shared) and (reason := read_stop(port, shared)) not in (None, GUARDIAN_DIED):
        raise latched_error(port, reason)


def latched_error(port: Port, reason: str | None) -> LatchedError:
    """The error for a board whose stop was not reset."""
    return LatchedError(
        f"{port} is stopped: {reason}", remedy="look at the rig, then: eldir rig reset --rig RIG"
    )


def unlatch(port: Port, shared: Path = SHARED_FOLDER) -> None:
    """Remove the stop of a board whose contacts were just proven open.

    Raises `EldirError` if the record cannot be removed, and as `require_proven_open`.
    """
    identity = identify(port)
    named = {_hashed_name(mark) for mark in (*identity.marks, identity.name)}
    require_proven_open(port, shared)
    with _open_for_removal(port, shared) as folder:
        found, problems = _read_all(folder)
        for name in (*_find_stops(found, port), *(named & problems.keys())):
            folder.remove(name)
    _logger.info("reset the stop of %s", port)


def require_proven_open(port: Port, shared: Path = SHARED_FOLDER) -> list[BoardRecord]:
    """The records of the board at `port`, whose contacts were just proven open, and of runs through its link.

    Raises `EldirError` if such a run drove another device whose contacts were not proven open.
    """
    identity = identify(port)
    with open_state_folder(shared) as folder:
        stops = _find_stops(_read_all(folder)[0], port)
        for name, record in stops.items():
            if record.opened is None and not record.identity.is_same_device(identity):
                raise EldirError(
                    "the contacts of the run are not proven open: "
                    f"{describe_move(str(port), record.identity)}",
                    code="stop.other-device",
                    remedy="connect it where it was, then: eldir rig off; if you never use it again, look at "
                    f"its contacts and remove {folder.path / name}",
                )
    return list(stops.values())


def _find_stops(found: Mapping[str, BoardRecord], port: Port) -> dict[str, BoardRecord]:
    """Records of the board at `port`, and those of runs through that name."""
    identity, name = identify(port), os.path.abspath(str(port))
    return {
        n: r
        for n, r in found.items()
        if r.identity.is_same_board(identity) or (r.opened is None and os.path.abspath(r.port) == name)
    }


def end_driving(port: Port, shared: Path = SHARED_FOLDER) -> None:
    """Remove the record of a board after a normal end. A stop that was latched in the meantime remains.

    Raises `EldirError` if the record cannot be removed.
    """
    identity = identify(port)
    with _open_for_removal(port, shared) as folder:
        for name, record in _read_all(folder)[0].items():
            if record.identity.is_same_device(identity) and record.stop == GUARDIAN_DIED:
                folder.remove(name)


@contextmanager
def _open_for_removal(port: Port, shared: Path) -> Iterator[StateFolder]:
    try:
        with open_state_folder(shared, exclusive=True) as folder:
            yield folder
    except OSError as error:
        raise EldirError(
            f"cannot remove the record of {port}: {error.strerror}", code="state.not-written"
        ) from None


def read_stop(port: Port, shared: Path = SHARED_FOLDER) -> str | None:
    """Reason of the stop of the board at `port`; `GUARDIAN_DIED` while it is driven; otherwise None."""
    identity = identify(port)
    stops = [r.stop for r in read_records(shared)[0].values() if r.identity.is_same_board(identity)]
    return min(stops, key=GUARDIAN_DIED.__eq__, default=None)


def find_record(port: Port, shared: Path = SHARED_FOLDER) -> BoardRecord | None:
    """The record of the device itself at `port`."""
    identity = identify(port)
    own = (r for r in read_records(shared)[0].values() if r.identity.is_same_device(identity))
    return next(own, None)


def read_records(shared: Path = SHARED_FOLDER) -> tuple[dict[str, BoardRecord], dict[str, str]]:
    """All records, and the problems of the other files, by file name. Raises `StateError`."""
    with open_state_folder(shared) as folder:
        return _read_all(folder)


def _read_all(folder: StateFolder) -> tuple[dict[str, BoardRecord], dict[str, str]]:
    found, problems = {}, {}
    for name in folder.names():
        if name.startswith((".", SPRINGS_PREFIX)):  # an incomplete draft: the previous record counts
            continue
        try:
            record = _parse_record(folder.read(name))
        except FileNotFoundError:
            continue
        except StateError as error:
            problems[name] = str(error)
        except DAMAGE_ERRORS:
            problems[name] = f"{folder.path / name} is damaged"
        else:
            found[name] = record
    return found, problems


def _parse_record(data: bytes) -> BoardRecord:
    values: dict[str, Any] = json.loads(data)
    if values.pop("format") != FORMAT:
        raise ValueError("unknown format")
    identity, sensor = (
        BoardIdentity.from_json(values.pop("identity"), values["port"]),
        values.pop("sensor", None),
    )
    record = BoardRecord(identity, **values, sensor=sensor and BoardIdentity.from_json(sensor))
    texts = (record.port, record.stop, record.since)
    optional = (record.kind, record.rig)
    if not all(isinstance(t, str) for t in texts) or not all(
        t is None or isinstance(t, str) for t in optional
    ):
        raise ValueError("an entry is not a text")
    if not isinstance(record.channels, int | None) or not isinstance(record.opened, int | float | None):
        raise ValueError("an entry is not a number")
    if not isinstance(record.sensor_entries, dict | None):
        raise ValueError("the entries of the sensor are not an object")
    return record


def _write_record(folder: StateFolder, name: str, record: BoardRecord) -> None:
    values = asdict(record) | {"identity": record.identity.to_json()}
    values["sensor"] = record.sensor and record.sensor.to_json()
    folder.write(name, json.dumps({"format": FORMAT} | values, indent=1).encode())


def remove_vanished(folder: StateFolder, kind: str = _RECORD_PREFIX) -> None:
    """Remove the files of pseudo-terminals that no longer exist, and their incomplete drafts."""
    for name in folder.names():
        if name.lstrip(".").startswith(kind):
            try:
                identity = BoardIdentity.from_json(json.loads(folder.read(name))["identity"])
            except (OSError, StateError, *DAMAGE_ERRORS):
                continue
            if is_gone_pseudo_terminal(identity):
                folder.remove(name)


def record_file_name(identity: BoardIdentity, kind: str = _RECORD_PREFIX) -> str:
    """Name of a board's file: its record or its springs.

    It depends on the device: two boards that use one link one after the other have two files.
    """
    return _hashed_name(min(identity.hardware or identity.marks, default=identity.name), kind)


def _hashed_name(mark: str, kind: str = _RECORD_PREFIX) -> str:
    return f"{kind}{hashlib.sha256(mark.encode()).hexdigest()[:16]}.json"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
