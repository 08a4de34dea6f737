"""What is printed of an error and of those behind it."""

import os
import pty
import subprocess
import sys
from itertools import pairwise

import pytest

from eldir.errors import EldirError, HazardError, describe, report


def replaced(*errors: BaseException) -> BaseException:
    """The last of several errors, each raised while the one before was handled."""
    for before, after in pairwise(errors):
        after.__context__ = before
    return errors[-1]


HOT, OTHER_HOT = "channel 2 is hot; cut the supply", "current flows in channel 3"
DISK = "the disk is full"


@pytest.mark.parametrize(
    ("error", "lines"),
    [
        (EldirError(DISK), [DISK]),
        (replaced(HazardError(HOT), EldirError(DISK)), [HOT, DISK]),
        (replaced(HazardError(HOT), HazardError(OTHER_HOT), EldirError(DISK)), [OTHER_HOT, HOT, DISK]),
        (replaced(EldirError(DISK), HazardError(HOT)), [HOT]),
        (replaced(HazardError(HOT), EldirError(DISK), KeyboardInterrupt()), [HOT]),
        (replaced(HazardError(HOT), ValueError("a bug")), [HOT]),
        (ExceptionGroup("two", [EldirError(DISK), HazardError(HOT)]), [HOT]),
        (
            replaced(HazardError("channel 2 is hot"), HazardError(f"not proven: {HOT}")),
            [f"not proven: {HOT}"],
        ),
    ],
    ids=range(8),
)
def test_hazards_are_printed_first_and_each_once(error, lines, capsys):
    if isinstance(error, EldirError):
        assert describe(error) == "; ".join(lines)
    for _ in range(2):
        report(error)
    said = capsys.readouterr()
    assert said.err.splitlines() == [f"eldir: {line}" for line in lines] and said.out == ""


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (KeyboardInterrupt(), "stopped by Ctrl-C; all open"),
        (EldirError("a\n b"), "a b; all open"),
        (ValueError("a bug"), "ValueError: a bug; all open"),
    ],
)
def test_a_note_stands_on_the_line_of_its_error(error, line, capsys):
    error.add_note("all open")
    report(error)
    assert capsys.readouterr().err == f"eldir: {line}\n"


def test_a_later_note_gets_a_line_of_its_own(capsys):
    error = HazardError(HOT)
    report(error)
    error.add_note(DISK)
    report(error)
    assert capsys.readouterr().err == f"eldir: {HOT}\neldir: {DISK}\n"


@pytest.mark.parametrize("where", ["stdout", "terminal"])
@pytest.mark.parametrize("stderr", ["/dev/full", "err.txt"])
def test_a_hazard_reaches_the_terminal_where_stderr_leads_elsewhere(where, stderr, tmp_path):
    """On stdout, or, where stderr cannot be written, on the terminal that the program was started from."""
    host, guest = pty.openpty()
    code = (
        "import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
        f"from eldir.errors import *; report(HazardError({HOT!r})); report(EldirError({DISK!r}))"
    )
    with open(os.path.join(tmp_path, stderr), "w") as err:
        out = guest if where == "stdout" else subprocess.DEVNULL
        program = subprocess.run(
            [sys.executable, "-c", code],
            stdin=guest,
            stdout=out,
            stderr=err,
            start_new_session=True,
            check=False,
        )
    os.write(guest, b".")
    said = ""
    while not said.endswith("."):
        said += os.read(host, 4096).decode()
    os.close(host)
    os.close(guest)
    reaches = where == "stdout" or stderr == "/dev/full"
    assert said == (f"eldir: {HOT}\r\n." if reaches else ".")
    if stderr != "/dev/full":
        assert (tmp_path / stderr).read_text() == f"eldir: {HOT}\neldir: {DISK}\n" and program.returncode == 0
