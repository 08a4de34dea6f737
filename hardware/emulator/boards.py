"""Which emulator stands in for which kind of board."""

from __future__ import annotations

from hardware.emulator.board import EmulatedBoard
from hardware.emulator.lcus import EmulatedLcus

EMULATORS: dict[str, type[EmulatedBoard]] = {"lcus": EmulatedLcus}
