"""The guardian's process through its client, on a pseudo-terminal: how it ends, and what is latched then."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from eldir.errors import EldirError
from eldir_hardware.clock import WallClock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.guardian import client
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.relay.errors import NotProvenOffError, RelayError
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_emulator
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import LatchedError, require_unlatched
from tests.hardware.emulated_rigs import rig_file, run, wait
from tests.raised import raises


@contextmanager
def bench(folder: Path, kind: str = "lcus") -> Iterator[tuple[EmulatedBoard, Rig]]:
    board = get_emulator(kind)(4, WallClock())
    board.start()
    path = rig_file(folder / "rig.yaml", kind, board.port)
    try:
        yield board, Rig.load(path)
    finally:
        board.faults.silent = False
        run("reset", "--rig", path)
        board.close()


def heat(bank: Guardian, board: EmulatedBoard) -> None:
    """Channel 1 closes for five seconds."""
    bank.arm()
    bank.heat(time.monotonic() + 0.3, {1: 5.0})
    deadline = time.monotonic() + 10.0
    while not board.contacts[0]:
        assert time.monotonic() < deadline
        bank.wait_until(time.monotonic() + 0.05)


def latched(rig: Rig, why: str) -> None:
    """No guardian arms now: this is what it asks first."""
    with pytest.raises(LatchedError, match=why):
        require_unlatched(rig.require_port())


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=pytest.mark.stress), signal.SIGHUP])
def test_signals_that_stop_the_guardian(tmp_path, number):
    with bench(tmp_path) as (board, rig):
        with Guardian(rig) as bank, pytest.raises(EldirError, match=f"stopped by {number.name}"):
            heat(bank, board)
            os.kill(bank.process, number)
            bank.wait_until(time.monotonic() + 5.0)
        assert not any(board.contacts)
        latched(rig, f"stopped by {number.name}")


def test_ctrl_c_is_for_the_program(tmp_path):
    """Which gets it too, from the terminal, and decides."""
    with bench(tmp_path) as (board, rig), Guardian(rig) as bank:
        heat(bank, board)
        os.kill(bank.process, signal.SIGINT)
        bank.wait_until(time.monotonic() + 0.5)
        assert board.contacts[0]
        bank.disarm()


def test_one_that_is_started_as_in_the_product_heats_and_has_loaded_no_yaml(tmp_path, monkeypatch):
    monkeypatch.setattr(client, "subprocess", subprocess)
    with bench(tmp_path) as (board, rig), Guardian(rig) as bank:
        loaded = Path(f"/proc/{bank.process}/maps").read_text()
        assert "numpy" in loaded and "_yaml" not in loaded, "it starts sooner without YAML"
        heat(bank, board)
        bank.disarm()
        assert not any(board.contacts)


def test_after_both_slept_the_program_that_wakes_first_does_not_blame_the_guardian(tmp_path):
    with bench(tmp_path, "modbus") as (board, rig), Guardian(rig) as bank:
        heat(bank, board)
        os.kill(bank.process, signal.SIGSTOP)
        time.sleep(0.8)  # nor do we keep alive
        # The guardian says so, of the program or, if it was stopped while it waited for the board, of itself.
        with pytest.raises(EldirError, match=r"was suspended|no keepalive message|was delayed by"):
            bank.keep_alive()
            os.kill(bank.process, signal.SIGCONT)
            bank.wait_until(time.monotonic() + 5.0)
        assert not any(board.contacts)


def test_a_program_that_looks_seldom_still_notices_a_guardian_that_hangs(tmp_path):
    with bench(tmp_path) as (board, rig), Guardian(rig) as bank:
        heat(bank, board)
        os.kill(bank.process, signal.SIGSTOP)
        with raises(EldirError, "guardian.gone", match="hung; all contacts are open"):
            for _ in range(3):
                time.sleep(0.7)
                bank.keep_alive()
        assert not any(board.contacts)


@pytest.mark.parametrize("order", ["stop", "error"])
def test_a_stop_that_the_board_does_not_confirm(tmp_path, order):
    """It is latched all the same, and the supply must be cut."""
    with bench(tmp_path) as (board, rig):
        with Guardian(rig) as bank, pytest.raises(NotProvenOffError, match="cut the heating supply now"):
            heat(bank, board)
            board.faults.silent = True
            if order == "stop":
                bank.stop("a key")
            bank.wait_until(time.monotonic() + 5.0)
        board.faults.silent = False
        latched(rig, "not proven that everything is off")


def test_arming_that_the_board_does_not_confirm(tmp_path):
    """A contact that stays closed: it was driven, so the stop is latched with its reason."""
    with bench(tmp_path) as (board, rig):
        board.set_coil(2, True)
        board.faults.deaf.add(2)
        with Guardian(rig) as bank, pytest.raises(NotProvenOffError, match="channel 2 did not switch"):
            bank.arm()
        board.faults.deaf.clear()
        latched(rig, "not proven that everything is off: relay channel 2 did not switch")


def test_a_guardian_that_dies_where_its_board_is_silent(tmp_path):
    """The stop is latched before the contacts are opened, which may fail."""
    with bench(tmp_path) as (board, rig):
        with (
            Guardian(rig) as bank,
            pytest.raises(NotProvenOffError, match="guardian died, and the contacts"),
        ):
            heat(bank, board)
            board.faults.silent = True
            os.kill(bank.process, signal.SIGKILL)
            bank.wait_until(time.monotonic() + 5.0)
        assert wait(lambda: not any(board.contacts)), "opened all the same"
        board.faults.silent = False
        latched(rig, "the guardian died")


def test_a_stop_says_why_and_is_latched(tmp_path):
    with bench(tmp_path) as (board, rig):
        with Guardian(rig) as bank:
            heat(bank, board)
            bank.stop("a key")
            assert not any(board.contacts)
            bank.stop("another key")
        latched(rig, "a key")


def test_a_guardian_that_never_armed_latches_nothing(tmp_path):
    """A board that was not driven needs no reset."""
    with bench(tmp_path) as (_, rig):
        with Guardian(rig) as bank:
            os.kill(bank.process, signal.SIGTERM)
            with pytest.raises(EldirError):
                bank.wait_until(time.monotonic() + 5.0)
        with Guardian(rig) as bank, bank.armed():
            pass


@pytest.mark.parametrize("how", ["cut", "end", pytest.param("disarm", marks=pytest.mark.stress)])
def test_orders_that_open_without_a_stop(tmp_path, how):
    with bench(tmp_path) as (board, rig):
        with Guardian(rig) as bank:
            heat(bank, board)
            if how == "cut":
                bank.abort_pulses()
                bank.wait_until(time.monotonic() + 0.5)
                assert not any(board.contacts)
            if how != "end":
                bank.disarm()
                assert not any(board.contacts)
        assert not any(board.contacts)
        if how != "end":
            with Guardian(rig) as bank, bank.armed():
                pass


def test_a_pulse_that_is_refused_is_told_to_the_program(tmp_path):
    with bench(tmp_path) as (board, rig), Guardian(rig) as bank:
        heat(bank, board)
        bank.heat(time.monotonic() + 1.0, {7: 1.0})
        with raises(LimitError, "limit.other-wiring", match="channel 7"):
            bank.wait_until(time.monotonic() + 2.0)
        bank.disarm()


def test_a_port_that_cannot_be_opened(tmp_path):
    rig = Rig.load(rig_file(tmp_path / "rig.yaml", "lcus", "/dev/no-such-port"))
    with pytest.raises(RelayError, match="cannot open the relay board's port"), Guardian(rig):
        pass


def test_off_ends_a_guardian_that_hangs(tmp_path):
    """It does not hear SIGTERM; it is killed as the last resort, and the contacts are opened."""
    with bench(tmp_path) as (board, rig):
        with Guardian(rig) as bank:
            heat(bank, board)
            os.kill(bank.process, signal.SIGSTOP)
            result = run("off", "--rig", tmp_path / "rig.yaml")
            assert result.exit_code == 0, result.output
            assert not any(board.contacts)
            with pytest.raises(EldirError):
                bank.wait_until(time.monotonic() + 3.0)
        latched(rig, "is stopped")
