"""Who drives a port: by the kernel's lock, never by a number that someone wrote down."""

import signal
import subprocess
import sys
from contextlib import contextmanager

from eldir_hardware.relay.errors import PortError
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import open_board
from eldir_hardware.rig.port_holder import (
    GuardedPort,
    find_holder,
    get_lock,
    list_guarded_ports,
    signal_holder,
)
from tests.hardware.emulated_rigs import emulated, rig_file, wait
from tests.raised import raises

LOCK = """
import fcntl, os, sys, time
handle = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
fcntl.flock(handle, fcntl.LOCK_EX)
if "child" in sys.argv and os.fork():
    os._exit(0)
print(os.getpid(), flush=True)
time.sleep(30)
"""
OPEN = LOCK.replace("fcntl.flock(handle, fcntl.LOCK_EX)", "")


@contextmanager
def program(code: str, *words: str):
    with subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield int(process.stdout.readline())
        finally:
            process.kill()


def test_the_emulator_and_others_that_have_it_open_do_not_drive():
    with emulated("lcus") as board, program(OPEN, board.port):
        assert find_holder(board.port) is None
    assert find_holder(board.port) is None, "a port that has gone"


def test_the_process_with_the_lock_drives(tmp_path):
    with emulated("lcus") as board:
        rig = Rig.load(rig_file(tmp_path / "rig.yaml", "lcus", board.port))
        with program(LOCK, board.port) as process:
            holder = find_holder(board.port)
            assert holder.process == process and not holder.suspended
            told = f"process {process} .*{board.port}"
            with raises(PortError, "board.port-in-use", match=told), open_board(rig):
                pass
        assert wait(lambda: find_holder(board.port) is None)
        with open_board(rig), raises(PortError, "board.port-in-use"), open_board(rig):
            pass


def test_a_lock_that_a_child_has_inherited():
    """The kernel still names the process that took it; that number may be another process's by now."""
    with emulated("lcus") as board, program(LOCK, board.port, "child") as child:
        assert wait(lambda: (find_holder(board.port) or (0,))[0] == child)
        assert signal_holder(board.port, child, signal.SIGKILL)
        assert wait(lambda: find_holder(board.port) is None)


def test_not_a_holder_is_not_signalled():
    """A number is no proof: the process has the port open, but not its lock."""
    with emulated("lcus") as board, program(OPEN, board.port) as innocent:
        assert not signal_holder(board.port, innocent, signal.SIGKILL)
        with program(LOCK, board.port):
            assert not signal_holder(board.port, innocent, signal.SIGKILL)
        assert not signal_holder(board.port, 2**22 - 1, signal.SIGKILL)
        assert not wait(lambda: not is_alive(innocent), 0.2)


def is_alive(process: int) -> bool:
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_command_line_alone_makes_no_guardian():
    """A process that calls itself the guardian of a port whose lock it does not hold."""
    with emulated("lcus") as one, emulated("lcus") as two:
        words = ["eldir-guardian", "3", two.port, "gd32", "4", "/dev/link"]
        with program(LOCK.replace("sys.argv[1]", repr(one.port)), *words) as process:
            assert find_holder(one.port).process == process
            assert process not in [g.process for g in list_guarded_ports()]
        words[2] = one.port
        with program(LOCK.replace("sys.argv[1]", repr(one.port)), *words) as process:
            (found,) = (g for g in list_guarded_ports() if g.process == process)
            assert found == GuardedPort(process, one.port, "gd32", 4, "/dev/link", get_lock(one.port))
