"""Springs that a real guardian has heated rest before the next run."""

import os
import signal
import time

import pytest
import yaml

from eldir_hardware.guardian.client import Guardian
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.drive import open_bank
from eldir_hardware.safety.latch import unlatch
from eldir_hardware.safety.limits import LimitError
from eldir_hardware.safety.spring_memory import (
    load_springs,
)
from tests.hardware.emulated_rigs import emulated, heating_program, rig_file, wait
from tests.hardware.rigs_and_schedules import rig_text
from tests.raised import raises

pytestmark = pytest.mark.usefixtures("state_folder")


def test_a_second_run_waits_for_the_springs_of_the_first(tmp_path):
    """The first one is stopped while it heats, and reset."""
    with emulated("lcus") as board:
        rig = Rig.load(rig_file(tmp_path / "rig.yaml", "lcus", board.port))
        with pytest.raises(KeyboardInterrupt), Guardian(rig) as bank, bank.armed():
            assert bank.ready_at <= time.monotonic()
            bank.heat(time.monotonic() + 0.3, {1: 5.0})
            bank.wait_until(time.monotonic() + 1.0)
            raise KeyboardInterrupt
        opened = max(edge.t for edge in board.contact_events)
        unlatch(board.port)
        assert load_springs(board.port)[1].pulses_s
        with Guardian(rig) as bank, bank.armed():
            assert bank.ready_at >= opened + rig.limits.min_off_s - 0.1
            bank.heat(time.monotonic() + 0.3, {1: 1.0})
            with raises(LimitError, "limit.no-rest", match="channel 1"):
                bank.wait_until(time.monotonic() + 3.0)
        assert not any(board.contacts)


def test_springs_that_were_rewired_after_a_run_rest_before_the_next(tmp_path):
    """The heated spring moved from channel 1 to channel 3, and the rig file says so."""
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        with Guardian(Rig.load(path)) as bank, bank.armed():
            bank.heat(time.monotonic() + 0.3, {1: 1.0})
            bank.wait_until(time.monotonic() + 1.6)
        values = yaml.safe_load(path.read_text())
        one, three = values["channels"][0], values["channels"][2]
        one["channel"], three["channel"] = 3, 1
        path.write_text(yaml.safe_dump(values))
        with Guardian(Rig.load(path)) as bank, bank.armed():
            assert bank.ready_at > time.monotonic() + 5.0
            bank.heat(time.monotonic() + 0.3, {3: 1.0})
            with raises(LimitError, "limit.no-rest", match="channel 3"):
                bank.wait_until(time.monotonic() + 3.0)


def test_after_a_guardian_was_killed_its_springs_count_as_hot(tmp_path):
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        with heating_program(board, path) as (program, guardian):
            os.kill(guardian, signal.SIGKILL)
            assert program.wait(15) and wait(lambda: not any(board.contacts))
        assert load_springs(board.port) is None
        unlatch(board.port)
        rig = Rig.load(path)
        with Guardian(rig) as bank, bank.armed():
            assert bank.ready_at >= time.monotonic() + rig.limits.min_off_s - 1.0


def test_springs_of_a_virtual_rig_begin_cold_with_it(tmp_path, state_folder):
    values = yaml.safe_load(rig_text(clock="wall"))
    del values["camera"]
    with open_bank(Rig.from_json(values)) as opened, opened.bank.armed():
        assert opened.bank.ready_at <= opened.clock.now()
    assert not list(state_folder.glob("springs-*.json"))
