"""What is known of a board's springs from one run to the next: a file for each board, beside the stops.

It says "may be hot" from when a guardian arms until it has proven everything off, so that the springs of
one that was killed count as hot.
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
from eldir.parameters.wiring import Face
from eldir_hardware.rig.board_identity import BoardIdentity, Port, identify
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.latch import (
    DAMAGED,
    SPRINGS,
    boottime,
    drop_gone,
    file_name,
    require_proven_open,
    unlatch,
)
from eldir_hardware.safety.limits import longest_pulse
from eldir_hardware.safety.state_folder import SHARED, StateError, StateFolder, state_folder

FORGOTTEN = 72 * 3600.0
"""The thickest springs have cooled after this time, in the stillest air that a rig file may state [s]."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_HOTTEST = 2000.0  # [C]; Nitinol has melted
_Temperature = Annotated[float, Field(gt=-_HOTTEST, lt=_HOTTEST)]
_Fraction = Annotated[float, Field(ge=0, le=1)]
_Seconds = Annotated[float, Field(ge=0)]
Place = tuple[Annotated[int, Field(ge=0)], Face]
"""Number and face of a spring, as the rig file's `channels` say."""


@record
class SpringHeat(Record):
    """The spring of one channel at some instant."""

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
    place: Place | None = None
    """Number and face of the spring that the channel heated, by the rig file; null where nobody knows.
    Without it the hottest of the board's springs counts for all."""

    def __post_init__(self) -> None:
        if any(begin < end for begin, end in self.pulses_s):
            raise ValueError("a pulse ends before it begins")

    def after(self, seconds: float) -> SpringHeat:
        """The same, so much later."""
        return replace(self, age_s=self.age_s + seconds)

    def and_also(self, other: SpringHeat) -> SpringHeat:
        """What two files say of one spring: the worse of everything."""
        warmest = (
            max(self.temperature_c[0], other.temperature_c[0]),
            max(self.temperature_c[1], other.temperature_c[1]),
        )
        least = min(self.martensite[0], other.martensite[0]), min(self.martensite[1], other.martensite[1])
        place = self.place if self.place == other.place else None
        return SpringHeat(warmest, least, self.pulses_s + other.pulses_s, min(self.age_s, other.age_s), place)


Springs = Mapping[int, SpringHeat]
"""Springs by channel. One that is left out is cold."""


@record
class RememberedSprings(FileRecord):
    """What is known of a board's springs from one run to the next, in the state folder."""

    FORMAT = "eldir-springs/1"

    identity: Annotated[BoardIdentity, PlainSerializer(BoardIdentity.values)]
    """What names the board."""
    boot: str
    """The kernel's name of this start of the computer."""
    at: float
    """When this was written, since the computer started [s]."""
    springs: dict[int, SpringHeat] | None
    """The spring of each channel; null from when a guardian arms until it has proven everything off."""


def at_the_ceiling(rig: Rig) -> dict[int, SpringHeat]:
    """Every spring that the board may heat, as hot as the limits allow."""
    hot = SpringHeat((rig.limits.max_temperature_c,) * 2, (0.0, 0.0), ((longest_pulse(rig), 0.0),))
    return dict.fromkeys(range(1, rig.board.channels + 1), hot)


def heat_of(springs: Springs, channel: int, place: Place) -> list[SpringHeat]:
    """All that may be true of the spring that this channel heats now; empty if it is cold.

    Heat follows the spring, and its contact's pulses the channel: both count. If the channel heated another
    spring before, or nobody knows which, somebody has moved wires or numbered springs anew: it may be any of
    the board's springs.
    """
    known = springs.get(channel)
    if known is None or known.place != place:
        return list(springs.values())
    return [heat for c, heat in springs.items() if c == channel or heat.place == place]


def joined(spans: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Times from begin to end in order; those that overlap as one."""
    found: list[tuple[float, float]] = []
    for begin, end in sorted(spans):
        if found and begin <= found[-1][1]:
            found[-1] = found[-1][0], max(end, found[-1][1])
        else:
            found.append((begin, end))
    return found


def remembered(port: Port, shared: Path = SHARED) -> Springs | None:
    """What is known of the springs of the board at `port`; None if they may be as hot as the limits allow.

    A file that cannot be read counts as hot springs.
    """
    try:
        with state_folder(shared) as folder:
            files = _own(folder, identify(port))
    except (OSError, StateError):
        return None
    found: dict[int, SpringHeat] = {}
    for springs in files.values():
        if springs is None:
            return None
        for channel, heat in springs.items():
            if heat.age_s < FORGOTTEN:
                found[channel] = heat.and_also(found[channel]) if channel in found else heat
    return found


def remember(port: Port, springs: Springs | None, shared: Path = SHARED) -> None:
    """Replace what is known of the springs at `port`; None if they may be hot from now on.

    Raises `EldirError` if it cannot be written; the file before it is still there then.
    """
    identity = identify(port)
    file = RememberedSprings(identity, _boot(), boottime(), None if springs is None else dict(springs))
    name = file_name(identity, SPRINGS)
    try:
        with state_folder(shared, alone=True) as folder:
            drop_gone(folder, SPRINGS)
            folder.write(name, json.dumps(file.to_json(), indent=1).encode())
            for other in _own(folder, identity, whole=True):
                if other != name:
                    folder.remove(other)
    except (OSError, StateError) as error:
        raise EldirError(
            f"cannot write how hot the springs of {port} are: {error}",
            code="state.not-written",
            remedy="free disk space or mend that folder: the next run needs it",
        ) from None


def reset(port: Port, rig: Rig, shared: Path = SHARED) -> None:
    """Allow heating again after a stop: every contact of the board at `port` was just proven open.

    A stop of a run through the same link counts too, and is reset where its own device was proven open.
    Raises `EldirError` where a device was not, or if something cannot be written.
    """
    devices = [record.identity for record in require_proven_open(port, shared)]
    if rig.kind == "real":
        for each in (*devices, port):
            settle(each, rig, shared)
    unlatch(port, shared)


def settle(port: Port, rig: Rig, shared: Path = SHARED) -> None:
    """Springs that may be hot are at most at the ceiling now, and cool from here: every contact was just seen
    open.

    Also those of another device whose run went through the same link. Raises `EldirError` if it cannot be
    written.
    """
    if remembered(port, shared) is None:
        for device in (*_maybe_hot(port, shared), port):
            remember(device, at_the_ceiling(rig), shared)


def _maybe_hot(port: Port, shared: Path) -> list[BoardIdentity]:
    """The devices behind `port`, now or in a run through the same link, whose springs may be hot."""
    found = []
    with suppress(OSError, StateError), state_folder(shared) as folder:
        for name, springs in _own(folder, identify(port)).items():
            if springs is None:
                with suppress(*DAMAGED, StateError):
                    found.append(BoardIdentity.of(json.loads(folder.read(name))["identity"]))
    return found


def _own(folder: StateFolder, identity: BoardIdentity, whole: bool = False) -> dict[str, Springs | None]:
    """Files of one board. One that is damaged belongs to the board of its name.

    `whole`: only files all of whose marks are this board's. Others may be another board's in the same socket.
    """
    names = {file_name(BoardIdentity(identity.name, frozenset([m])), SPRINGS) for m in identity.marks}
    names.add(file_name(identity, SPRINGS))
    found: dict[str, Springs | None] = {}
    for name in folder.names():
        if not name.startswith(SPRINGS):
            continue
        try:
            values = json.loads(folder.read(name))
            theirs = BoardIdentity.of(values["identity"])
            if theirs.same_board(identity) and (not whole or theirs.marks <= identity.marks):
                found[name] = _springs(values)
        except FileNotFoundError:
            continue
        except (EldirError, *DAMAGED):
            if name in names:
                found[name] = None
    return found


def _springs(values: dict[str, Any]) -> Springs | None:
    """Raises `ValueError` and others for values that are none, or of another format."""
    if values["format"] != RememberedSprings.FORMAT:
        raise ValueError("another format")
    file = RememberedSprings.from_json(values)
    # After a restart of the computer they have cooled for as long as it has run, or longer.
    age = boottime() - (file.at if file.boot == _boot() else 0.0)
    if not age >= 0:
        raise ValueError("it is of the future")
    return file.springs and {channel: heat.after(age) for channel, heat in file.springs.items()}


def _boot() -> str:
    """What tells one start of the computer from another."""
    try:
        return _BOOT.read_text().strip()
    except OSError:
        return ""
