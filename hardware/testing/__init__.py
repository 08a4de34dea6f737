"""Test doubles for people who write a board of their own: emulated boards, their faults, damaged bytes, time.

Public, with a page: docs/reference/test-doubles.md. Nothing of eldir itself imports this room. The virtual
camera is in `hardware.vision`, the virtual rig in `hardware.virtual`.
"""

from hardware.clock import VirtualClock
from hardware.emulator.board import Edge, EmulatedBoard, Faults
from hardware.rig.boards import driver_of, emulator_of
from hardware.testing.damaged_wire import Damage, DamagedWire, wired
from hardware.testing.powered_board import Powered, close_contacts, pass_time, powered

__all__ = [
    "Damage",
    "DamagedWire",
    "Edge",
    "EmulatedBoard",
    "Faults",
    "Powered",
    "VirtualClock",
    "close_contacts",
    "driver_of",
    "emulator_of",
    "pass_time",
    "powered",
    "wired",
]
