"""Test doubles for people who write a board of their own: emulated boards, their faults, damaged bytes, time.

Public, with a page: docs/reference/test-doubles.md. Nothing of eldir itself imports this room. The virtual
camera is in `eldir_hardware.vision`, the virtual rig in `eldir_hardware.virtual`.
"""

from eldir_hardware.clock import VirtualClock
from eldir_hardware.emulator.board import ContactEvent, EmulatedBoard, Faults
from eldir_hardware.rig.boards import driver_of, emulator_of
from eldir_hardware.testing.damaged_wire import Damage, DamagedWire, wired
from eldir_hardware.testing.powered_board import Powered, close_contacts, pass_time, powered

__all__ = [
    "ContactEvent",
    "Damage",
    "DamagedWire",
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
