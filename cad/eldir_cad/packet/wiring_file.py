"""Reads the wiring of a packet, also of an older one or one filled in by hand."""

from __future__ import annotations

import csv
from itertools import pairwise
from pathlib import Path

from eldir.core.files import read_file
from eldir.errors import damaged
from eldir.parameters.wiring import FACES, Connection, Wiring

NAME = "wiring.csv"
_MAX_BYTES = 64 << 10  # 128 rows have five thousand
_MAX_CHANNELS = 64  # also the limit for motors


def read_wiring(packet: Path) -> Wiring:
    """The relay channels in `wiring.csv` of a packet. Raises `InputError` for a folder without a valid
    one."""
    path = packet / NAME
    text = read_file(path, _MAX_BYTES, "name the folder that eldir packet wrote").decode(
        "utf-8-sig", "replace"
    )
    try:
        return _check_unique(sorted(_connection(row) for row in csv.DictReader(text.splitlines())))
    except (csv.Error, KeyError, TypeError, ValueError) as error:
        expected = "columns spring, face and relay_channel, each channel in one row"
        raise damaged(path, expected, str(error)[:80], "write the packet again: eldir packet") from None


def _check_unique(connections: list[Connection]) -> Wiring:
    if not connections:
        raise ValueError("no rows")
    for one, other in pairwise(connections):
        if one.channel == other.channel:
            raise ValueError(f"channel {one.channel} in two rows")
    return tuple(connections)


def _connection(row: dict[str, str]) -> Connection:
    channel, spring = int(row["relay_channel"]), int(row["spring"])
    for face in (*FACES, "both"):
        if face == row["face"] and 1 <= channel <= _MAX_CHANNELS and 0 <= spring < _MAX_CHANNELS:
            return Connection(channel, spring, face)
    raise ValueError(f"spring {spring}, face {row['face']!r}, channel {channel}")
