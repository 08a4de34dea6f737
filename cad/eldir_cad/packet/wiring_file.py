"""Reads the wiring of a packet that was written, also by an older version or filled in by hand."""

from __future__ import annotations

import csv
from itertools import pairwise
from pathlib import Path

from eldir.core.files import read_file
from eldir.errors import damaged
from eldir.parameters.wiring import FACES, Connection, Wiring

NAME = "wiring.csv"
_LARGEST = 64 << 10  # [bytes]; 128 rows have five thousand
_MOST = 64  # channels and motors


def read_wiring(packet: Path) -> Wiring:
    """The map in a packet's `wiring.csv`. Raises `InputError` for a folder that is no packet."""
    path = packet / NAME
    text = read_file(path, _LARGEST, "name the folder that eldir packet wrote").decode("utf-8-sig", "replace")
    try:
        return _map(sorted(_connection(row) for row in csv.DictReader(text.splitlines())))
    except (csv.Error, KeyError, TypeError, ValueError) as error:
        expected = "columns spring, face and relay_channel, each channel in one row"
        raise damaged(path, expected, str(error)[:80], "write the packet again: eldir packet") from None


def _map(connections: list[Connection]) -> Wiring:
    if not connections:
        raise ValueError("no rows")
    for one, other in pairwise(connections):
        if one.channel == other.channel:
            raise ValueError(f"channel {one.channel} in two rows")
    return tuple(connections)


def _connection(row: dict[str, str]) -> Connection:
    channel, spring = int(row["relay_channel"]), int(row["spring"])
    for face in FACES:
        if face == row["face"] and 1 <= channel <= _MOST and 0 <= spring < _MOST:
            return Connection(channel, spring, face)
    raise ValueError(f"spring {spring}, face {row['face']!r}, channel {channel}")
