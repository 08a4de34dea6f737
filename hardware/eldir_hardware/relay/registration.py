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
    max_channels: int = 16
    """Number of relays of the largest board of this kind."""


def installed_kinds() -> tuple[str, ...]:
    """The installed kinds of relay board, sorted by name."""
    return tuple(sorted(_entry_points(tuple(sys.path))))


def kinds_text() -> str:
    """The installed kinds as a command's help lists them: "feedback | gd32 | ..."."""
    return " | ".join(installed_kinds())


def get_board(kind: str) -> Board:
    """The board of that kind. Raises `InputError` with the installed kinds for an unknown one."""
    remedy = "correct the kind, or install the package that provides this board"
    if not installed_kinds():
        remedy = "install eldir again: its list of boards is older than its code"
    require_known("kind of relay board", kind, installed_kinds(), remedy)
    point = _entry_points(tuple(sys.path))[kind]
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
            f"invalid registration of the relay board {kind}",
            code="package.broken",
            expected=f"{point.value} to be an `eldir_hardware.relay.registration.Board`",
            found=type(board).__name__,
            remedy="repair or remove the package that provides it",
        )
    return board


@lru_cache(maxsize=4)
def _entry_points(path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Entry points by name; `path` is the import path on which they were searched.

    Another package cannot replace a board of eldir: `eldir rig off` must reach the board of the rig file.
    """
    sorted_points = sorted(
        entry_points(group=GROUP), key=lambda point: point.value.startswith("eldir_hardware.relay.")
    )
    return {point.name: point for point in sorted_points}
