"""The installed relay boards: entry points of the group `eldir.boards`, of any package.

A package adds a board with one line in its pyproject.toml; the name on the left is the board's kind:

    [project.entry-points."eldir.boards"]
    toy = "my_boards.toy:BOARD"
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from eldir.core.entry_points import load_registered, registered_names, require_registered

if TYPE_CHECKING:
    from eldir_hardware.relay.board import RelayBoard

GROUP, _WHAT = "eldir.boards", "kind of relay board"


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
    return registered_names(GROUP)


def kinds_text() -> str:
    """The installed kinds as a command's help lists them: "feedback | gd32 | ..."."""
    return " | ".join(installed_kinds())


def get_board(kind: str) -> Board:
    """The board of that kind. Raises `InputError` with the installed kinds for an unknown one."""
    if not installed_kinds():
        remedy = "install eldir again: its list of boards is older than its code"
        require_registered(GROUP, kind, _WHAT, remedy)
    return load_registered(GROUP, kind, _WHAT, Board)
