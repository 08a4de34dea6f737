"""The program log: its levels, and a stderr that nobody reads."""

import fcntl
import logging
import os
import pty
import select
import socket
import subprocess
import sys
import termios
import tty

import pytest

from eldir.core import program_log
from eldir.errors import InputError
from tests.paths import NODES

WRITE = """
import logging, sys, time
from eldir.core.program_log import configure
configure("writer")
begun = time.monotonic()
for number in range(3000):
    logging.getLogger("eldir_hardware.relay").debug("line %d", number)
print(time.monotonic() - begun, flush=True)
sys.stdin.readline()
logging.getLogger("eldir_hardware.relay").debug("the last line")
"""


@pytest.mark.parametrize(
    ("text", "levels"),
    [
        ("", {}),
        ("debug", {"": "debug"}),
        (" INFO ,", {"": "info"}),
        ("eldir_hardware.relay=debug,warning", {"eldir_hardware.relay": "debug", "": "warning"}),
        ("error, numpy.linalg = info", {"": "error", "numpy.linalg": "info"}),
    ],
)
def test_levels_of_the_variable(text, levels, monkeypatch):
    monkeypatch.setenv("ELDIR_LOG", text)
    assert program_log.read_levels() == levels


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("loud", "expected error, warning, info, debug, or MODULE=LEVEL, separated by commas; found 'loud'"),
        ("hardware=", "expected error, .*; found 'hardware='"),
        ("info,relays=debug", "expected an installed module .*; found 'relays'"),
        ("json.decoder.port=debug", "expected an .*; found 'json.decoder.port'"),
        ("no_such_package=debug", "expected an .*; found 'no_such_package'"),
    ],
)
def test_a_wrong_variable_is_one_line(text, problem, monkeypatch):
    monkeypatch.setenv("ELDIR_LOG", text)
    with pytest.raises(InputError, match=f"^invalid ELDIR_LOG; {problem}$"):
        program_log.read_levels()


@pytest.mark.parametrize(
    ("before", "steps", "after"),
    [
        ("", 1, "info"),
        ("", 2, "debug"),
        ("", 9, "debug"),
        ("error", 1, "info"),
        ("info", 1, "debug"),
        ("debug", 1, "debug"),
        ("eldir_hardware.relay=debug,eldir_cad=error", 1, "eldir_hardware.relay=debug,eldir_cad=error,info"),
    ],
)
def test_each_v_is_one_step(before, steps, after, monkeypatch):
    monkeypatch.setenv("ELDIR_LOG", before)
    program_log.raise_level(steps)
    assert os.environ["ELDIR_LOG"] == after


def test_importing_configures_nothing():
    """A program of another person decides itself what is written, and where."""
    code = (
        "import logging, eldir, eldir_cad, eldir_calibration, eldir_app, eldir_ros\n"
        "import eldir_hardware.relay.line, eldir.rollout\n"
        "print(logging.getLogger().handlers, logging.getLogger().level, logging.raiseExceptions)\n"
        "from eldir.core.program_log import PACKAGES\n"
        "for name in PACKAGES:\n"
        "    own = logging.getLogger(name)\n"
        "    print(name, [type(h).__name__ for h in own.handlers], own.level, own.propagate)\n"
        "    own.warning('nobody listens')\n"
    )
    said = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"ELDIR_LOG": "debug"},
        cwd=NODES,
    )
    packages = [f"{name} ['NullHandler'] 0 True" for name in program_log.PACKAGES]
    assert said.stdout.splitlines() == ["[] 30 True", *packages] and said.stderr == ""


def stalled_pipe() -> tuple[int, int]:
    return os.pipe()


def stalled_terminal() -> tuple[int, int]:
    host, guest = pty.openpty()
    tty.setraw(guest)
    return host, guest


def stopped_terminal() -> tuple[int, int]:
    """As by Ctrl-S."""
    host, guest = stalled_terminal()
    termios.tcflow(guest, termios.TCOOFF)
    return host, guest


def stalled_socket() -> tuple[int, int]:
    ours, theirs = socket.socketpair()
    return ours.detach(), theirs.detach()


@pytest.mark.parametrize("stalled", [stalled_pipe, stalled_terminal, stopped_terminal, stalled_socket])
def test_a_stderr_that_takes_nothing_is_not_waited_for(stalled):
    """And when it takes lines again, they come, with the number of those that are left out."""
    host, guest = stalled()
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITE],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=guest, text=True,
        env=os.environ | {"ELDIR_LOG": "eldir_hardware.relay=debug"},
    )  # fmt: skip
    try:
        assert float(writer.stdout.readline()) < 5.0
        assert not fcntl.fcntl(guest, fcntl.F_GETFL) & os.O_NONBLOCK, "other programs share it"
        if stalled is stopped_terminal:
            termios.tcflow(guest, termios.TCOON)
        read = drain(host)
        writer.communicate("\n", timeout=30)
        read += drain(host)
    finally:
        writer.kill()
        os.close(guest)
        os.close(host)
    lines = read.decode().splitlines()
    assert writer.returncode == 0
    written = sum("eldir_hardware.relay: line " in line for line in lines)
    left_out = sum(int(line.split()[3]) for line in lines if line.startswith("eldir: left out "))
    # A terminal makes room in pieces: each time it may take a part of the last line that it takes.
    assert 0 <= 3000 - left_out - written <= (5 if "terminal" in stalled.__name__ else 0) and left_out > 0
    assert lines[-1].endswith("DEBUG   writer eldir_hardware.relay: the last line")


def drain(handle: int) -> bytes:
    """Everything that comes until nothing more does; a terminal passes on what it has a little later."""
    read = b""
    while select.select([handle], [], [], 0.5)[0]:
        try:
            part = os.read(handle, 1 << 16)
        except OSError:
            break
        if not part:
            break
        read += part
    return read


def test_a_file_gets_every_line(tmp_path):
    """Also one that something was written to before."""
    (tmp_path / "err.txt").write_text("before\n")
    with (tmp_path / "err.txt").open("r+") as file:
        file.seek(0, os.SEEK_END)
        subprocess.run(
            [sys.executable, "-c", WRITE],
            input="\n", stdout=subprocess.DEVNULL, stderr=file, text=True, check=True,
            env=os.environ | {"ELDIR_LOG": "debug"},
        )  # fmt: skip
    lines = (tmp_path / "err.txt").read_text().splitlines()
    assert lines[0] == "before" and len(lines) == 3002 and lines[-1].endswith("the last line")


@pytest.mark.parametrize("how", ["2>&-", "2>/dev/full", "2>/dev/null"])
def test_a_stderr_that_is_gone(how):
    done = subprocess.run(
        ["sh", "-c", f'exec "$0" -c "$1" {how}', sys.executable, WRITE],
        input="\n", stdout=subprocess.PIPE, text=True, check=False, env=os.environ | {"ELDIR_LOG": "debug"},
    )  # fmt: skip
    assert done.returncode == 0 and float(done.stdout) < 5.0


def test_quiet_lines_are_those_of_errors():
    code = (
        "import logging; from eldir.core.program_log import configure; configure('x');"
        "logging.getLogger('eldir_cad.kit').warning('a note');"
        "logging.getLogger('eldir_cad.kit').info('nothing')"
    )
    plain = {name: value for name, value in os.environ.items() if name != "ELDIR_LOG"}
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=plain)
    assert said.stderr == "eldir: a note\n"
    assert logging.getLogger("eldir_cad").level == logging.NOTSET
