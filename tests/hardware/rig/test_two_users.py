"""Two users of one computer: neither can stop, block or mislead the other. Only root can make them."""

import os
import pty
import signal
import subprocess
import sys
import tempfile
import time
import tty
from contextlib import contextmanager
from pathlib import Path

import pytest

from eldir_hardware.clock import WallClock
from eldir_hardware.rig.devices import get_emulator
from eldir_hardware.rig.port_holder import find_holder
from tests.hardware.emulated_rigs import HEAT, emulated, rig_file, wait
from tests.hardware.rig.other_users import start

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can act for two users")

ANNA, BERT, RIGS = 12345, 65534, 4321
OFF = [sys.executable, "-m", "eldir", "rig", "off"]


@pytest.fixture
def homes():
    """A state folder for each user, below a folder that both can enter."""
    base = Path(tempfile.mkdtemp(prefix="eldir-two-users-", dir="/tmp"))
    base.chmod(0o755)
    for user in (ANNA, BERT):
        folder = base / str(user)
        folder.mkdir(mode=0o700)
        os.chown(folder, user, user)
    yield base
    # A guardian writes into its folder until it has ended.
    assert wait(lambda: subprocess.run(["rm", "-rf", str(base)], check=False).returncode == 0)


def run(user: int, base: Path, words: list[str], group: int | None = None) -> tuple[int, str, float]:
    begun = time.monotonic()
    with start(user, base, words, group) as program:
        out, err = program.communicate(timeout=30)
    return program.returncode, out + err, time.monotonic() - begun


@contextmanager
def heating(board, base: Path, mode: int, group: int = ANNA):
    """Anna heats; her rig file is her own."""
    os.chown(board.port, ANNA, group)
    os.chmod(board.port, mode)
    path = rig_file(base / str(ANNA) / "rig.yaml", "lcus", board.port)
    os.chown(path, ANNA, ANNA)
    with start(ANNA, base, [sys.executable, "-c", HEAT, str(path)]) as program:
        try:
            first = program.stdout.readline()
            assert first, program.stderr.read()
            assert wait(lambda: any(board.contacts)), program.stderr.read()
            yield path, program, int(first)
        finally:
            program.kill()


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_another_user_who_may_not_open_the_port_stops_nothing(homes):
    with emulated("lcus") as board, heating(board, homes, 0o600) as (path, program, guardian):
        for words in ([], ["--port", board.port], ["--rig", str(path)]):
            status, text, _ = run(BERT, homes, [*OFF, *words])
            assert status == 1, text
        assert "Permission denied" in run(BERT, homes, [*OFF, "--port", board.port])[1]
        lock = f"import fcntl, os; fcntl.flock(os.open({board.port!r}, os.O_RDONLY), fcntl.LOCK_EX)"
        assert "PermissionError" in run(BERT, homes, python(lock))[1], "no lock without the right to open"
        time.sleep(0.3)
        assert any(board.contacts) and program.poll() is None
        assert find_holder(board.port).process == guardian


def test_another_user_who_may_open_the_port_opens_the_contacts(homes):
    """The right to use a port includes the emergency stop; the guardian sees the open contacts, and ends."""
    with emulated("lcus") as board, heating(board, homes, 0o660, RIGS) as (path, program, guardian):
        begun = time.monotonic()
        status, text, took = run(BERT, homes, [*OFF, "--port", board.port], RIGS)
        assert status == 0 and "all 4 channels are open" in text, text
        assert f"process {guardian} of user {ANNA} cannot be ended" in text
        assert not any(board.contacts)
        opened = max(e.t for e in board.contact_events) - begun
        print(f"\n| port of another user | contacts open {opened:.2f} s | end {took:.2f} s |")
        assert program.wait(15) == 1
        status, text, _ = run(ANNA, homes, [*OFF, "--rig", str(path)])
        assert status == 0, text


def test_a_suspended_guardian_of_another_user(homes):
    """It cannot be ended and does not let go of the port: the contacts open, but nothing is proven."""
    with emulated("lcus") as board, heating(board, homes, 0o660, RIGS) as (_, program, guardian):
        for number in (guardian, program.pid):
            os.kill(number, signal.SIGSTOP)
        status, text, took = run(BERT, homes, [*OFF, "--port", board.port], RIGS)
        assert status == 1 and "cut the heating supply now" in text and took < 8.0
        assert f"process {guardian} of user {ANNA} cannot be ended" in text
        assert not any(board.contacts)
        os.kill(guardian, signal.SIGKILL)


def test_root_stops_the_run_of_another_user(homes, tmp_path, monkeypatch):
    """The kernel names the process; its command line tells the kind of board; that user's stop is latched."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for hangs in (False, True):
        with emulated("lcus") as board, heating(board, homes, 0o600) as (_, _, guardian):
            if hangs:
                os.kill(guardian, signal.SIGSTOP)
            words = [*OFF, "--port", board.port]  # without a port it would stop the guardians of other tests
            done = subprocess.run(words, capture_output=True, text=True, timeout=30, check=False)
            assert done.returncode == 0 and not any(board.contacts), done.stdout + done.stderr
            assert f"stopped process {guardian}" in done.stdout
            code = f"from eldir_hardware.safety import latch; latch.require_unlatched({board.port!r})"
            assert "is stopped" in run(ANNA, homes, python(code))[1]


PLANT = """
import hashlib, os, pathlib, sys
port, victim, innocent = sys.argv[1:]
name = port + str(os.stat(port).st_ctime_ns)
digest = hashlib.sha256(name.encode()).hexdigest()[:16]
lock, latch = f"/tmp/eldir-port-{digest}", f"/tmp/eldir-stop-{digest}"  # names of version 0.1
pathlib.Path(lock).write_text(innocent)
os.mkfifo(latch)
os.mkfifo("eldir")  # in the own state folder
for place in (victim, victim + "/eldir"):
    try:
        (pathlib.Path(place) / "board-0.json").write_text(innocent)
        sys.exit("planted in " + place)
    except PermissionError:
        pass
print(lock, latch)
"""


def plant(base: Path, port: str, innocent: int) -> list[str]:
    """What another user can leave, under names of version 0.1 and in the own folder. Returns the files."""
    status, text, _ = run(BERT, base, [*python(PLANT), port, str(base / str(ANNA)), str(innocent)])
    assert status == 0, text
    return text.split()


def test_what_another_user_plants_changes_nothing(homes):
    """A file with the number of a process of root, pipes and links under all names that were ever used."""
    with (
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as innocent,
        emulated("lcus") as board,
    ):
        planted = plant(homes, board.port, innocent.pid)
        try:
            with heating(board, homes, 0o600) as (path, program, _):
                status, text, took = run(ANNA, homes, [*OFF, "--rig", str(path)])
                assert status == 0 and not any(board.contacts), text
                assert took < 4.0, "no pipe was waited for"
                assert program.wait(15) == 1
            code = (
                "from typer.testing import CliRunner; from eldir_app.commands.rig import rig; "
                f"result = CliRunner().invoke(rig, ['reset', '--rig', {str(path)!r}]); "
                "print(result.output, result.exception)"
            )
            assert "the stop is reset" in run(ANNA, homes, python(code))[1]
            assert innocent.poll() is None, "the process of root was left alone"
        finally:
            innocent.kill()
            for name in planted:
                Path(name).unlink(missing_ok=True)


def test_a_state_folder_that_another_user_made_is_refused(homes):
    """A folder that was there before, such as below a shared XDG_STATE_HOME."""
    folder = homes / str(ANNA) / "eldir"
    folder.mkdir(mode=0o777)
    folder.chmod(0o777)
    os.chown(folder, BERT, BERT)
    code = "from eldir_hardware.safety.latch import require_unlatched; require_unlatched('/dev/null')"
    text = run(ANNA, homes, python(code))[1]
    assert f"belongs to user {BERT}" in text and "counts as stopped" in text


def test_a_folder_of_a_group_is_shared(homes):
    """What one member latches stops the other; a user outside is refused, and told why."""
    shared = homes / "shared"
    shared.mkdir()
    os.chown(shared, 0, RIGS)
    shared.chmod(0o2770)
    host, guest = pty.openpty()
    tty.setraw(host)
    port = os.ttyname(guest)
    begin = (
        f"from pathlib import Path; from eldir_hardware.safety import latch as l; s = Path({str(shared)!r}); "
    )
    latch = begin + f"print(l.latch({port!r}, 'anna stopped it', shared=s))"
    check = begin + f"l.require_unlatched({port!r}, shared=s)"
    reset = begin + f"l.unlatch({port!r}, shared=s)"
    assert run(ANNA, homes, python(latch), RIGS)[:2] == (0, "None\n")
    assert "anna stopped it" in run(BERT, homes, python(check), RIGS)[1]
    assert "ask to be in its group" in run(BERT, homes, python(check))[1]
    assert run(BERT, homes, python(reset), RIGS)[0] == 0
    assert run(ANNA, homes, python(check), RIGS)[:2] == (0, "")
    os.close(host)
    os.close(guest)


def test_the_lock_is_seen_across_users(homes):
    """A second user with the right to use the port cannot drive it at the same time."""
    board = get_emulator("lcus")(4, WallClock())
    board.start()
    with heating(board, homes, 0o660, RIGS) as (_, program, guardian):
        path = rig_file(homes / "bert.yaml", "lcus", board.port)
        path.chmod(0o644)
        status, text, _ = run(BERT, homes, python(HEAT.replace("sys.argv[1]", repr(str(path)))), RIGS)
        assert status == 1 and f"process {guardian} already drives {board.port}" in text, text
        assert any(board.contacts) and program.poll() is None
    board.close()
