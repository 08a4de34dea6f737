"""The virtual rig in real time: a busy computer holds up the emulated board, which must not look dead, and a
simulation that is slower than the clock is told."""

import logging
import threading
import time

import pytest

from eldir.errors import EldirError
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.guardian.bank import HeaterBank
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.drive import open_virtual_bank
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.emulated_rigs import rig_file
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston

LATE = 0.25
"""A real board's answer would be late, an emulated one's may be on a busy computer [s]."""


def watch(bank: HeaterBank, board: EmulatedBoard) -> None:
    """Armed, but some of the board's answers are late."""
    with bank.armed():
        board.faults.late = LATE
        bank.wait_until(time.monotonic() + 3 * LATE)
        board.faults.late = 0.0
        bank.wait_until(time.monotonic() + 3 * LATE)


def test_only_an_emulated_board_may_answer_late(tmp_path):
    rig = rig_with(virtual={"clock": "wall"})
    with VirtualRig(rig, Piston()) as virtual:
        with open_virtual_bank(virtual, rig) as bank:
            watch(bank, virtual.emulator)
        real = Rig.load(rig_file(tmp_path / "rig.yaml", "lcus", virtual.emulator.port))
        with pytest.raises(EldirError, match="did not answer"), Guardian(real) as bank:
            watch(bank, virtual.emulator)


class Slow(Piston):
    """A body whose simulation takes longer than what it simulates."""

    def move(self, lengths, interval):
        super().move(lengths, interval)
        time.sleep(1.2)


@pytest.mark.parametrize("body", [Slow, Piston])
def test_a_simulation_that_is_slower_than_the_clock_is_told_once(body, caplog):
    frames, second = [], threading.Event()

    def on_frame(frame):
        frames.append(frame)
        if len(frames) > 1:
            second.set()

    with caplog.at_level(logging.WARNING), VirtualRig(rig_with(virtual={"clock": "wall"}), body()) as virtual:
        virtual.start = virtual.clock.now()
        virtual.watch(10.0, on_frame)
        assert second.wait(60)
        virtual.stop_watching()
    assert ["behind the clock" in r.getMessage() for r in caplog.records] == [True] * (body is Slow)
