"""Which driver speaks to which kind of board."""

from __future__ import annotations

from collections.abc import Callable

from hardware.clock import Clock
from hardware.relay.board import RelayBoard
from hardware.relay.lcus import LcusBoard

DRIVERS: dict[str, Callable[[str, int, Clock], RelayBoard]] = {"lcus": LcusBoard}
"""Each opens a board by port, number of channels and clock."""
