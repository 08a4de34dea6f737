"""What is known of a board's springs from one run to the next: a file for each board, beside the stops.

It says "may be hot" from when a guardian arms until it has proven everything off, so that the springs of
one that was killed count as hot.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from eldir.errors import EldirError
from hardware.rig.board_identity import BoardIdentity, identify, is_gone_pseudo_terminal
from hardware.safety.latch import SPRINGS, boottime, file_name
from hardware.safety.state_folder import SHARED, StateError, StateFolder, state_folder

FORMAT = "eldir-springs/1"
FORGOTTEN = 3600.0
"""Springs have cooled after this time, in the stillest air that a rig file may state [s]."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_HOTTEST = 2000.0  # [C]; Nitinol has melted


class SpringHeat(NamedTuple):
    """The spring of one channel when its memory was written."""

    temperature_c: tuple[float, float]
    """Of the nominal spring and of the hottest one within the tolerances [C]."""
    martensite: tuple[float, float]
    """Martensite fractions of both."""
    pulses_s: tuple[tuple[float, float], ...]
    """When it was closed and opened, in the last minute [s before the memory was written]."""


@dataclass(frozen=True)
class SpringMemory:
    """The springs of a board, by channel."""

    age: float
    """Time since then [s]."""
    springs: Mapping[int, SpringHeat] | None
    """None: they may be as hot as the limits allow."""


def remembered(port: str, shared: Path = SHARED) -> SpringMemory | None:
    """What is known of the springs of the board at `port`; None if they have cooled, or were never heated.

    A file that cannot be read counts as hot springs.
    """
    try:
        with state_folder(shared) as folder:
            found = _own(folder, identify(port))
    except (OSError, StateError):
        return SpringMemory(0.0, None)
    known = [memory for _, memory in found if memory.age < FORGOTTEN]
    return min(known, key=lambda memory: (memory.springs is not None, memory.age), default=None)


def remember(port: str, springs: Mapping[int, SpringHeat] | None, shared: Path = SHARED) -> None:
    """Replace what is known of the springs at `port`; None if they may be hot from now on.

    Raises `EldirError` if it cannot be written; the file before it is still there then.
    """
    identity = identify(port)
    values: dict[str, Any] = {
        "format": FORMAT,
        "identity": {"name": identity.name, "marks": sorted(identity.marks)},
        "boot": _boot(),
        "at": boottime(),
        "springs": None if springs is None else {str(c): heat._asdict() for c, heat in springs.items()},
    }
    name = file_name(identity, SPRINGS)
    try:
        with state_folder(shared) as folder:
            _drop_gone(folder)
            folder.write(name, json.dumps(values, indent=1).encode())
            for other, _ in _own(folder, identity):
                if other != name:  # under a mark that the board has no longer
                    folder.remove(other)
    except (OSError, StateError) as error:
        raise EldirError(
            f"cannot write how hot the springs of {port} are: {error}",
            remedy="free disk space or mend that folder: the next run needs it",
        ) from None


def _own(folder: StateFolder, identity: BoardIdentity) -> list[tuple[str, SpringMemory]]:
    """Files of one board. One that is damaged belongs to the board of its name."""
    found = []
    for name in folder.names():
        if not name.startswith(SPRINGS):
            continue
        try:
            values = json.loads(folder.read(name))
            if values["format"] != FORMAT:
                raise ValueError("another format")
            if not _identity(values).same_board(identity):
                continue
            found.append((name, _memory(values)))
        except FileNotFoundError:
            continue
        except (StateError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            if name == file_name(identity, SPRINGS):
                found.append((name, SpringMemory(0.0, None)))
    return found


def _memory(values: dict[str, Any]) -> SpringMemory:
    """Raises `ValueError` and others for values that are none."""
    if values["springs"] is None:  # nobody knows when this ended
        return SpringMemory(0.0, None)
    # After a restart of the computer they have cooled for as long as it has run, or longer.
    at = float(values["at"]) if values["boot"] == _boot() else 0.0
    age = boottime() - at
    if not age >= 0:
        raise ValueError("it is of the future")
    return SpringMemory(age, {int(c): _heat(heat) for c, heat in values["springs"].items()})


def _heat(values: dict[str, Any]) -> SpringHeat:
    temperature, martensite = (
        (float(a), float(b)) for a, b in (values["temperature_c"], values["martensite"])
    )
    pulses = tuple((float(begin), float(end)) for begin, end in values["pulses_s"])
    sound = (
        all(-_HOTTEST < t < _HOTTEST for t in temperature)
        and all(0 <= xi <= 1 for xi in martensite)
        and all(math.inf > begin >= end >= 0 for begin, end in pulses)
    )
    if not sound:
        raise ValueError("no state of a spring")
    return SpringHeat(temperature, martensite, pulses)


def _identity(values: dict[str, Any]) -> BoardIdentity:
    return BoardIdentity(str(values["identity"]["name"]), frozenset(map(str, values["identity"]["marks"])))


def _drop_gone(folder: StateFolder) -> None:
    """Remove the files of pseudo-terminals that no longer exist."""
    for name in folder.names():
        if name.startswith(SPRINGS):
            try:
                identity = _identity(json.loads(folder.read(name)))
            except (OSError, StateError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
                continue
            if is_gone_pseudo_terminal(identity):
                folder.remove(name)


def _boot() -> str:
    """What tells one start of the computer from another."""
    try:
        return _BOOT.read_text().strip()
    except OSError:
        return ""
