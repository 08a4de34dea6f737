"""The MOSFET board's time limit where real programs are killed."""

import os
import signal
import subprocess
import sys
import time

import pytest

from eldir_hardware.clock import WallClock
from eldir_hardware.emulator.mosfet import EmulatedMosfet
from eldir_hardware.safety.latch import unlatch
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import rig_file, wait

WITHIN = 0.8  # 0.4 s by the board's clock; the rest is for a machine too busy to run the emulator [s]

HOLD = """
import sys, time
from eldir_hardware.clock import WallClock
from eldir_hardware.relay.mosfet import MosfetBoard
board = MosfetBoard(sys.argv[1], 4, WallClock())
board.all_off()
while True:
    board.hold({1: 0.4, 2: 1.0}, 5.0)
    print(time.monotonic(), flush=True)
    time.sleep(0.1)
"""


def test_a_program_without_a_guardian_that_is_killed_leaves_nothing_on() -> None:
    """Pulses of 5 s, so that only the heartbeat can end them."""
    emulated = EmulatedMosfet(4, WallClock())
    with subprocess.Popen([sys.executable, "-c", HOLD, emulated.start()], stdout=subprocess.PIPE) as program:
        try:
            assert wait(lambda: emulated.contacts == (True, True, False, False))
            died = time.monotonic()
            program.kill()
            assert wait(lambda: not any(emulated.contacts), 3.0)
        finally:
            program.kill()
            emulated.close()
    seconds = max(e.t for e in emulated.contact_events) - died
    print(f"\nprogram killed, no guardian: off after {seconds:.3f} s")
    assert seconds < WITHIN


HEAT = """
import sys, time
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.rig.configuration import Rig
with Guardian(Rig.load(sys.argv[1])) as bank, bank.armed():
    bank.heat(time.monotonic() + 0.3, {1: 5.0, 2: 5.0, 3: 5.0, 4: 5.0})
    print(bank.process, flush=True)
    bank.wait_until(time.monotonic() + 20)
"""


@pytest.mark.parametrize("attempt", [0, *(pytest.param(a, marks=pytest.mark.stress) for a in (1, 2))])
def test_both_programs_killed(attempt: int, tmp_path) -> None:
    emulated = EmulatedMosfet(4, WallClock())
    path = rig_file(tmp_path / "rig.yaml", "mosfet", emulated.start())
    with Forked(
        [sys.executable, "-c", HEAT, str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as program:
        try:
            guardian = int(program.stdout.readline())
            assert wait(lambda: all(emulated.contacts)), program.stderr.read()
            time.sleep(0.3 + 0.17 * attempt)
            os.kill(program.pid, signal.SIGSTOP)  # so that neither sees the other one die
            os.kill(guardian, signal.SIGKILL)
            died = time.monotonic()
            program.kill()
            assert wait(lambda: not any(emulated.contacts), 3.0)
        finally:
            program.kill()
            unlatch(emulated.port)
            emulated.close()
    seconds = max(e.t for e in emulated.contact_events) - died
    print(f"\nboth killed: off after {seconds:.3f} s")
    assert seconds < WITHIN
