"""The state of a board's springs between two runs: a file for each board, beside the stops.

From arming until everything was proven off it says that springs may be hot, so that those of a guardian that
was killed count as hot.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, PlainSerializer

from eldir.core.records import FileRecord, Record, record
from eldir.errors import EldirError
from eldir.parameters.wiring import HeatedFaces
from eldir_hardware.rig.board_identity import BoardIdentity, Port, identify
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.latch import (
    DAMAGE_ERRORS,
    SPRINGS_PREFIX,
    record_file_name,
    remove_vanished,
    require_proven_open,
    unlatch,
    uptime,
)
from eldir_hardware.safety.limits import max_pulse
from eldir_hardware.safety.state_folder import SHARED_FOLDER, StateError, StateFolder, open_state_folder

MAX_AGE = 72 * 3600.0
"""The thickest springs have cooled after this time, in the stillest air that a rig file may state [s]."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_MAX_TEMPERATURE = 2000.0  # [C]; Nitinol has melted
_Temperature = Annotated[float, Field(gt=-_MAX_TEMPERATURE, lt=_MAX_TEMPERATURE)]
_Fraction = Annotated[float, Field(ge=0, le=1)]
_Seconds = Annotated[float, Field(ge=0)]
SpringPlace = tuple[Annotated[int, Field(ge=0)], HeatedFaces]
"""Number and face of a spring, or of both springs in series, as the rig file's `channels` say."""


@record
class SpringHeat(Record):
    """State of the spring of one channel at one instant."""

    OPTIONAL = frozenset({"place"})

    temperature_c: tuple[_Temperature, _Temperature]
    """Modelled temperatures of the nominal spring and of the hottest one within the tolerances [C]."""
    martensite: tuple[_Fraction, _Fraction]
    """Martensite fractions of both."""
    pulses_s: tuple[tuple[_Seconds, _Seconds], ...]
    """When the channel was closed and opened in the minute before the instant of this state [s before it]."""
    age_s: _Seconds = 0.0
    """Time from the instant of this state until this was written [s]: not 0 for channels of another rig
    file."""
    place: SpringPlace | None = None
    """Number and face of the spring that the channel heated, by the rig file; null where nobody knows.
    Without it the hottest of the board's springs counts for all."""

    def __post_init__(self) -> None:
        if any(begin < end for begin, end in self.pulses_s):
            raise ValueError("a pulse ends before it begins")

    def aged_by(self, seconds: float) -> SpringHeat:
        """The same state, `seconds` later."""
        return replace(self, age_s=self.age_s + seconds)

    def worst_of_both(self, other: SpringHeat) -> SpringHeat:
        """The worst case of two states of one spring."""
        temperature = (
            max(self.temperature_c[0], other.temperature_c[0]),
            max(self.temperature_c[1], other.temperature_c[1]),
        )
        martensite = (
            min(self.martensite[0], other.martensite[0]),
            min(self.martensite[1], other.martensite[1]),
        )
        place = self.place if self.place == other.place else None
        return SpringHeat(
            temperature, martensite, self.pulses_s + other.pulses_s, min(self.age_s, other.age_s), place
        )


Springs = Mapping[int, SpringHeat]
"""States of springs by channel; a missing spring is cold."""


@record
class SavedSprings(FileRecord):
    """The state of a board's springs between two runs, in the state folder."""

    FORMAT = "eldir-springs/1"

    identity: Annotated[BoardIdentity, PlainSerializer(BoardIdentity.to_json)]
    """Identity of the board."""
    boot: str
    """The kernel's identifier of this start of the computer."""
    at: float
    """When this was written, since the computer started [s]."""
    springs: dict[int, SpringHeat] | None
    """The spring of each channel; null from when a guardian arms until it has proven everything off."""


def springs_at_limit(rig: Rig) -> dict[int, SpringHeat]:
    """Every spring that the board can heat, at the highest allowed temperature."""
    hot = SpringHeat((rig.limits.max_temperature_c,) * 2, (0.0, 0.0), ((max_pulse(rig), 0.0),))
    return dict.fromkeys(range(1, rig.board.channels + 1), hot)


def possible_spring_states(springs: Springs, channel: int, place: SpringPlace) -> list[SpringHeat]:
    """All possible states of the spring that this channel heats now; empty if it is cold.

    Temperatures belong to the spring, and pulses to the channel: both count. If the channel heated another or
    an unknown spring before, wires were moved or springs renumbered: it may be any of the board's springs.
    """
    known = springs.get(channel)
    if known is None or known.place != place:
        return list(springs.values())
    return [heat for c, heat in springs.items() if c == channel or heat.place == place]


def merge_intervals(spans: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """The intervals in order, overlapping ones merged."""
    found: list[tuple[float, float]] = []
    for begin, end in sorted(spans):
        if found and begin <= found[-1][1]:
            found[-1] = found[-1][0], max(end, found[-1][1])
        else:
            found.append((begin, end))
    return found


def load_springs(port: Port, shared: Path = SHARED_FOLDER) -> Springs | None:
    """The springs of the board at `port`; None if they may be at the highest allowed temperature.

    After an unreadable file springs count as hot.
    """
    try:
        with open_state_folder(shared) as folder:
            files = _read_own_files(folder, identify(port))
    except (OSError, StateError):
        return None
    found: dict[int, SpringHeat] = {}
    for springs in files.values():
        if springs is None:
            return None
        for channel, heat in springs.items():
            if heat.age_s < MAX_AGE:
                found[channel] = heat.worst_of_both(found[channel]) if channel in found else heat
    return found


def save_springs(port: Port, springs: Springs | None, shared: Path = SHARED_FOLDER) -> None:
    """Replace the saved springs at `port`; None if they may be hot from now on.

    Raises `EldirError` if they cannot be written, and keeps the old file then.
    """
    identity = identify(port)
    file = SavedSprings(identity, _boot_id(), uptime(), None if springs is None else dict(springs))
    name = record_file_name(identity, SPRINGS_PREFIX)
    try:
        with open_state_folder(shared, exclusive=True) as folder:
            remove_vanished(folder, SPRINGS_PREFIX)
            folder.write(name, json.dumps(file.to_json(), indent=1).encode())
            for other in _read_own_files(folder, identity, only_own=True):
                if other != name:
                    folder.remove(other)
    except (OSError, StateError) as error:
        raise EldirError(
            f"cannot save the state of the springs of {port}: {error}",
            code="state.not-written",
            remedy="free disk space or repair that folder: the next run needs it",
        ) from None


def reset_stop(port: Port, rig: Rig, shared: Path = SHARED_FOLDER) -> None:
    """Allow heating again after a stop: every contact of the board at `port` was just proven open.

    Stops of runs through the same link are reset, too, if their devices were proven open. Raises `EldirError`
    if one was not, or if something cannot be written.
    """
    devices = [record.identity for record in require_proven_open(port, shared)]
    if rig.kind == "real":
        for each in (*devices, port):
            start_cooling(each, rig, shared)
    unlatch(port, shared)


def start_cooling(port: Port, rig: Rig, shared: Path = SHARED_FOLDER) -> None:
    """Save springs that may be hot as cooling from the highest allowed temperature: every contact was just
    proven open.

    Also those of another device whose run used the same link. Raises `EldirError` if they cannot be written.
    """
    if load_springs(port, shared) is None:
        for device in (*_devices_with_hot_springs(port, shared), port):
            save_springs(device, springs_at_limit(rig), shared)


def _devices_with_hot_springs(port: Port, shared: Path) -> list[BoardIdentity]:
    """The devices behind `port`, now or in a run through the same link, whose springs may be hot."""
    found = []
    with suppress(OSError, StateError), open_state_folder(shared) as folder:
        for name, springs in _read_own_files(folder, identify(port)).items():
            if springs is None:
                with suppress(*DAMAGE_ERRORS, StateError):
                    found.append(BoardIdentity.from_json(json.loads(folder.read(name))["identity"]))
    return found


def _read_own_files(
    folder: StateFolder, identity: BoardIdentity, only_own: bool = False
) -> dict[str, Springs | None]:
    """The files of one board; a damaged file belongs to the board of its name.

    `only_own`: no files with marks of another board, which may have used the same socket.
    """
    names = {
        record_file_name(BoardIdentity(identity.name, frozenset([m])), SPRINGS_PREFIX) for m in identity.marks
    }
    names.add(record_file_name(identity, SPRINGS_PREFIX))
    found: dict[str, Springs | None] = {}
    for name in folder.names():
        if not name.startswith(SPRINGS_PREFIX):
            continue
        try:
            values = json.loads(folder.read(name))
            stored_identity = BoardIdentity.from_json(values["identity"])
            if stored_identity.is_same_board(identity) and (
                not only_own or stored_identity.marks <= identity.marks
            ):
                found[name] = _parse_springs(values)
        except FileNotFoundError:
            continue
        except (EldirError, *DAMAGE_ERRORS):
            if name in names:
                found[name] = None
    return found


def _parse_springs(values: dict[str, Any]) -> Springs | None:
    """Parse a file's values. Raises `ValueError` and others for invalid values or another format."""
    if values["format"] != SavedSprings.FORMAT:
        raise ValueError("unknown format")
    file = SavedSprings.from_json(values)
    # After a restart of the computer they have cooled at least since then.
    age = uptime() - (file.at if file.boot == _boot_id() else 0.0)
    if not age >= 0:
        raise ValueError("the saved time is later than the uptime of this computer")
    return file.springs and {channel: heat.aged_by(age) for channel, heat in file.springs.items()}


def _boot_id() -> str:
    """The kernel's identifier of this start of the computer."""
    try:
        return _BOOT.read_text().strip()
    except OSError:
        return ""
