"""Orders from another program to one that drives."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from eldir_hardware.run.remote_control import COMMANDS, obey_commands, send_command


class Told:
    """A player that notes what it is told."""

    def __init__(self):
        self.heard = []

    def __getattr__(self, name):
        return lambda: self.heard.append(name)


def told_by_another_program(process: int, *words: str) -> list[bool]:
    program = "import sys; from eldir_hardware.run.remote_control import send_command; "
    program += "print([send_command(int(sys.argv[1]), w) for w in sys.argv[2:]])"
    command = [sys.executable, "-c", program, str(process), *words]
    return eval(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def test_a_program_of_the_same_user_is_obeyed_until_the_end():
    player = Told()
    with obey_commands(player):
        assert told_by_another_program(os.getpid(), *COMMANDS, "heat", "") == [True] * 4 + [False] * 2
    assert player.heard == ["pause", "resume", "step", "finish_cycle"]
    assert not send_command(os.getpid(), "pause"), "the context has ended"


def test_another_user_is_not_obeyed():
    if os.geteuid() != 0:
        pytest.skip("only root can start a program of another user")
    player = Told()
    # root may order everybody; here the program that drives is root's, and the other one is not
    ask = "import os, socket; os.setuid(65534); s = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET); "
    ask += f"s.connect('\\0eldir-drive-{os.getpid()}'); s.send(b'resume'); print(s.recv(8))"
    with obey_commands(player):
        said = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=False)
    assert player.heard == [] and "b'ok'" not in said.stdout


def test_who_says_nothing_holds_nobody_up():
    """Neither the end of the run, nor the next order for long."""
    player = Told()
    with obey_commands(player):
        silent = [socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(3)]
        for one in silent:
            one.connect(f"\0eldir-drive-{os.getpid()}")
        begun = time.monotonic()
        assert send_command(os.getpid(), "pause")
        assert time.monotonic() - begun < 1.5
    assert time.monotonic() - begun < 2.0 and player.heard == ["pause"]
    for one in silent:
        one.close()


def test_a_program_that_hangs_does_not_answer():
    held = "from eldir_hardware.run.remote_control import obey_commands\n"
    held += "with obey_commands(None): print(flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", held], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        other.stdout.readline()
        other.send_signal(signal.SIGSTOP)
        begun = time.monotonic()
        assert not send_command(other.pid, "pause")
        assert time.monotonic() - begun < 3.0
        other.kill()


def test_a_program_that_has_taken_the_name_is_not_believed():
    other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as false:
            false.bind(f"\0eldir-drive-{other.pid}")
            false.listen(1)
            assert not send_command(other.pid, "pause")
    finally:
        other.kill()
        other.wait()
