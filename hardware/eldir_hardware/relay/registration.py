"""The installed relay boards: entry points of the group `eldir.boards`, of any package.

A package adds a board with one line in its pyproject.toml; the name on the left is the board's kind:

    [project.entry-points."eldir.boards"]
    toy = "my_boards.toy:BOARD"
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING

from eldir.core.arguments import require_known
from eldir.errors import InputError

if TYPE_CHECKING:
    from eldir_hardware.relay.board import RelayBoard

GROUP = "eldir.boards"


@dataclass(frozen=True)
class Board:
    """A kind of relay board, which an entry point of the group names."""

    driver: type[RelayBoard]
    """Opened with port, number of channels and clock."""
    emulator: str
    """Class of the emulated board, as "package.module:Class"; imported only where one is emulated."""
    most_channels: int = 16
    """Relays that the largest board of this kind has."""


def kinds() -> tuple[str, ...]:
    """The kinds of board that are installed, sorted by name."""
    return tuple(sorted(_found(tuple(sys.path))))


def board_of(kind: str) -> Board:
    """The board of that kind. Raises `InputError` with the installed kinds where there is none."""
    remedy = "correct the kind, or install the package that provides this board"
    if not kinds():
        remedy = "install eldir again: its installed list of boards is older than its code"
    require_known("kind of relay board", kind, kinds(), remedy)
    point = _found(tuple(sys.path))[kind]
    try:
        board = point.load()
    except (Exception, SystemExit) as error:  # another package's code runs here
        raise InputError(
            f"the relay board {kind} cannot be loaded from {point.value}",
            code="package.broken",
            found=f"{type(error).__name__}: {error}",
            remedy="repair or remove the package that provides it",
        ) from None
    if not isinstance(board, Board):
        raise InputError(
            f"the relay board {kind} is registered wrongly",
            code="package.broken",
            expected=f"{point.value} to be a eldir_hardware.relay.registration.Board",
            found=type(board).__name__,
            remedy="repair or remove the package that provides it",
        )
    return board


@lru_cache(maxsize=4)
def _found(path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Entry points by name; `path` is the import path that they were looked for on.

    No package can replace a board of this one: `eldir rig off` must reach the board that the rig file names.
    """
    ours_last = sorted(
        entry_points(group=GROUP), key=lambda point: point.value.startswith("eldir_hardware.relay.")
    )
    return {point.name: point for point in ours_last}
