"""The latched emergency stop of a board: a record that outlives programs and reboots until it is reset.

The record names the board by what stays when USB renumbers, and its kind, so that `eldir rig off` needs no
rig file. It is written before the first contact closes, and removed after a good end. A stop counts for every
board with which it has a mark in common, a link too; only the very device proves that its contacts are open.
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
    identify,
    is_gone_pseudo_terminal,
    is_pseudo_terminal,
    moved,
)
from eldir_hardware.safety.state_folder import SHARED, StateError, StateFolder, state_folder

_logger = logging.getLogger(__name__)

FORMAT = "eldir-board/1"
_RECORD = "board-"
SPRINGS = "springs-"
"""Begin of the names of files that are no stops (`eldir_hardware.safety.spring_memory`)."""
DAMAGED = (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError)
"""What the values of a damaged file raise."""
DIED = "the guardian that drove it died"
"""The reason in a record as long as the board is driven: it stays if the guardian vanishes."""


class LatchedError(EldirError):
    """Heating is refused until the stop is reset."""

    code = "stop.latched"


@dataclass(frozen=True)  # not pydantic's, whose import would delay an emergency stop
class BoardRecord:
    """A board that is driven, or stopped."""

    identity: BoardIdentity
    """What names the board."""
    port: str
    """Port through which it was driven."""
    stop: str
    """Why it is stopped; while it is driven, what a dead guardian would leave behind."""
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


def boottime() -> float:
    """Time since the computer started, suspended or not [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def require_unlatched(port: Port, shared: Path = SHARED) -> None:
    """Raise `LatchedError` if a stop of the board at `port` has not been reset, or if this is not known."""
    try:
        found, wrong = read_records(shared)
    except StateError as error:
        raise LatchedError(f"{port} counts as stopped: {error}") from None
    identity = identify(port)
    for record in found.values():
        if record.identity.same_board(identity):
            where = moved(str(port), record.identity)
            raise latched(port, f"{record.stop}{f'; {where}' if where else ''}")
    for problem in wrong.values():
        raise LatchedError(
            f"{port} counts as stopped: {problem}",
            remedy="look at the rig, remove that file, then: eldir rig off",
        )


def latch_for_driving(
    port: Port,
    kind: str,
    channels: int,
    rig: str,
    shared: Path = SHARED,
    sensor: BoardIdentity | None = None,
) -> None:
    """Record the board before it is driven, so that a guardian that dies leaves a stop behind."""
    identity = identify(port)
    record = BoardRecord(identity, str(port), DIED, _now(), kind, channels, rig, sensor=sensor)
    try:
        with state_folder(shared, alone=True) as folder:
            drop_gone(folder)
            _write(folder, file_name(identity), record)
    except (OSError, StateError) as error:
        raise EldirError(
            f"cannot write the record of {port}: {error}",
            code="state.not-written",
            remedy="free disk space or mend that folder: the emergency stop needs it",
        ) from None


def latch(port: Port, why: str, *, opened: bool = False, shared: Path = SHARED) -> str | None:
    """Latch a stop; the first reason stays. `opened`: every contact of this device was just proven open.

    Never fails: without a new record (a full disk) that of `latch_for_driving` stays. Returns the problem.
    """
    try:
        identity, when = identify(port), boottime() if opened else None
        with state_folder(shared, alone=True) as folder:
            found, _ = _read_all(folder)
            own = {n: r for n, r in found.items() if r.identity.same_device(identity)}
            if not own and (identity.marks or not is_pseudo_terminal(identity)):
                own[file_name(identity)] = BoardRecord(identity, str(port), DIED, _now())
            for name, record in own.items():
                reason = " ".join(why.split()) if record.stop == DIED else record.stop
                _write(folder, name, replace(record, stop=reason, since=_now(), opened=when or record.opened))
    except (OSError, StateError) as error:
        return str(error)
    _logger.info("latched the stop of %s: %s", port, why)
    return None


def require_unstopped(port: Port, shared: Path = SHARED) -> None:
    """Raise `LatchedError` if another user has stopped a board while it is driven.

    `eldir rig off` cannot signal another user's guardian, and between two pulses its frames change nothing.
    Only a shared folder tells of it.
    """
    if os.path.lexists(shared) and (reason := stop_of(port, shared)) not in (None, DIED):
        raise latched(port, reason)


def latched(port: Port, reason: str | None) -> LatchedError:
    """The error for a board whose stop has not been reset."""
    return LatchedError(
        f"{port} is stopped: {reason}", remedy="look at the rig, then: eldir rig reset --rig RIG"
    )


def unlatch(port: Port, shared: Path = SHARED) -> None:
    """Allow heating again, through a board whose contacts were just proven open.

    Raises `EldirError` if the record cannot be removed, and where `require_proven_open` does.
    """
    identity = identify(port)
    named = {_hashed(mark) for mark in (*identity.marks, identity.name)}
    require_proven_open(port, shared)
    with _removing(port, shared) as folder:
        found, wrong = _read_all(folder)
        for name in (*_stops(found, port), *(named & wrong.keys())):
            folder.remove(name)
    _logger.info("reset the stop of %s", port)


def require_proven_open(port: Port, shared: Path = SHARED) -> list[BoardRecord]:
    """The records of the board at `port`, whose contacts were just proven open, and of runs through its link.

    Raises `EldirError` where such a run drove another device, and nobody has proven that one's contacts open.
    """
    identity = identify(port)
    with state_folder(shared) as folder:
        stops = _stops(_read_all(folder)[0], port)
        for name, record in stops.items():
            if record.opened is None and not record.identity.same_device(identity):
                raise EldirError(
                    f"the contacts of the run are not proven open: {moved(str(port), record.identity)}",
                    code="stop.other-device",
                    remedy="connect it where it was, then: eldir rig off; if you never use it again, look at "
                    f"its contacts and remove {folder.path / name}",
                )
    return list(stops.values())


def _stops(found: Mapping[str, BoardRecord], port: Port) -> dict[str, BoardRecord]:
    """Records of the board at `port`, and those of runs through that name."""
    identity, name = identify(port), os.path.abspath(str(port))
    return {
        n: r
        for n, r in found.items()
        if r.identity.same_board(identity) or (r.opened is None and os.path.abspath(r.port) == name)
    }


def end_driving(port: Port, shared: Path = SHARED) -> None:
    """Remove the record of a board that was driven to a good end. A stop that was latched meanwhile stays.

    Raises `EldirError` if the record cannot be removed.
    """
    identity = identify(port)
    with _removing(port, shared) as folder:
        for name, record in _read_all(folder)[0].items():
            if record.identity.same_device(identity) and record.stop == DIED:
                folder.remove(name)


@contextmanager
def _removing(port: Port, shared: Path) -> Iterator[StateFolder]:
    try:
        with state_folder(shared, alone=True) as folder:
            yield folder
    except OSError as error:
        raise EldirError(
            f"cannot remove the record of {port}: {error.strerror}", code="state.not-written"
        ) from None


def stop_of(port: Port, shared: Path = SHARED) -> str | None:
    """Why the board at `port` is stopped or, while it is driven, `DIED`; None if it is neither."""
    identity = identify(port)
    stops = [r.stop for r in read_records(shared)[0].values() if r.identity.same_board(identity)]
    return min(stops, key=DIED.__eq__, default=None)


def record_of(port: Port, shared: Path = SHARED) -> BoardRecord | None:
    """The record of the very device at `port`."""
    identity = identify(port)
    own = (r for r in read_records(shared)[0].values() if r.identity.same_device(identity))
    return next(own, None)


def read_records(shared: Path = SHARED) -> tuple[dict[str, BoardRecord], dict[str, str]]:
    """All records, and what is wrong with the other files, by file name. Raises `StateError`."""
    with state_folder(shared) as folder:
        return _read_all(folder)


def _read_all(folder: StateFolder) -> tuple[dict[str, BoardRecord], dict[str, str]]:
    found, wrong = {}, {}
    for name in folder.names():
        if name.startswith((".", SPRINGS)):  # not completely written: the record before it counts
            continue
        try:
            record = _parse(folder.read(name))
        except FileNotFoundError:
            continue
        except StateError as error:
            wrong[name] = str(error)
        except DAMAGED:
            wrong[name] = f"{folder.path / name} is damaged"
        else:
            found[name] = record
    return found, wrong


def _parse(data: bytes) -> BoardRecord:
    values: dict[str, Any] = json.loads(data)
    if values.pop("format") != FORMAT:
        raise ValueError("another format")
    identity, sensor = BoardIdentity.of(values.pop("identity"), values["port"]), values.pop("sensor", None)
    record = BoardRecord(identity, **values, sensor=sensor and BoardIdentity.of(sensor))
    texts = (record.port, record.stop, record.since)
    optional = (record.kind, record.rig)
    if not all(isinstance(t, str) for t in texts) or not all(
        t is None or isinstance(t, str) for t in optional
    ):
        raise ValueError("an entry is no text")
    if not isinstance(record.channels, int | None) or not isinstance(record.opened, int | float | None):
        raise ValueError("an entry is no number")
    return record


def _write(folder: StateFolder, name: str, record: BoardRecord) -> None:
    values = asdict(record) | {"identity": record.identity.values()}
    values["sensor"] = record.sensor and record.sensor.values()
    folder.write(name, json.dumps({"format": FORMAT} | values, indent=1).encode())


def drop_gone(folder: StateFolder, kind: str = _RECORD) -> None:
    """Remove the files of pseudo-terminals that no longer exist, those that were never completed too."""
    for name in folder.names():
        if name.lstrip(".").startswith(kind):
            try:
                identity = BoardIdentity.of(json.loads(folder.read(name))["identity"])
            except (OSError, StateError, *DAMAGED):
                continue
            if is_gone_pseudo_terminal(identity):
                folder.remove(name)


def file_name(identity: BoardIdentity, kind: str = _RECORD) -> str:
    """Name of a board's file: of its record, or of what is known of its springs.

    By the device: two boards, one after the other behind one link, have two files.
    """
    return _hashed(min(identity.hardware or identity.marks, default=identity.name), kind)


def _hashed(mark: str, kind: str = _RECORD) -> str:
    return f"{kind}{hashlib.sha256(mark.encode()).hexdigest()[:16]}.json"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
