"""Opens a rig for a program that heats: the guardian of a real board, or an emulated one without a robot."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir_hardware.clock import Clock, VirtualClock, WallClock
from eldir_hardware.guardian.bank import HeaterBank
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.virtual.rig import VirtualRig


class OpenedBank(NamedTuple):
    """Springs that can be heated, and the clock of their times."""

    bank: HeaterBank
    clock: Clock


class _NoBody:
    """A body without masses, for a virtual rig without a robot."""

    springs: IntArray = np.zeros((0, 2), dtype=np.int32)
    positions: FloatArray = np.zeros((0, 2))
    remark = ""

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Ignore the springs."""


@contextmanager
def bank_of(rig: Rig) -> Iterator[OpenedBank]:
    """The springs of a real rig, or of a virtual one without a robot."""
    if rig.kind == "real":
        with Guardian(rig) as guardian:
            yield OpenedBank(guardian, WallClock())
        return
    with VirtualRig(rig, _NoBody()) as virtual, bank_on(virtual, rig) as bank:
        yield OpenedBank(bank, virtual.clock)


@contextmanager
def bank_on(virtual: VirtualRig, rig: Rig) -> Iterator[HeaterBank]:
    """The springs of a virtual rig; on the wall's clock behind a guardian process, as real ones are."""
    if isinstance(virtual.clock, VirtualClock):
        yield PulseController(virtual.board, rig, virtual.clock, sensor=virtual.sensor)
    else:
        with Guardian(rig, virtual.emulator.port, virtual.sensor_port) as guardian:
            yield guardian
