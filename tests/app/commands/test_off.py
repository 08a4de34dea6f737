"""`eldir rig off` as a user runs it: whatever the rig file says, whoever drives, whatever hangs.

`pytest -s` prints how long it takes from the start of the process, for docs/reference/safety-measured.md.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml

from eldir_hardware.relay.errors import SilentBoardError
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.safety import switch_off as switching
from eldir_hardware.safety.latch import GUARDIAN_DIED, latch_for_driving, read_records, read_stop
from eldir_hardware.safety.off_targets import OffTarget
from eldir_hardware.testing import close_contacts
from tests.hardware.emulated_rigs import each_once, emulated, heating_program, rig_file, wait
from tests.side_by_side import side_by_side

OFF = [sys.executable, "-m", "eldir", "rig", "off"]
QUICK = 1.5
"""Bound of the time that it may take on a machine that is busy with other work [s]."""


def off(*words: object, cwd: Path | None = None, before: Sequence[str] = ()):
    """Run the command; returns its result, and when it was started."""
    begun = time.monotonic()
    done = subprocess.run(
        [*before, *OFF, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        cwd=cwd,
    )
    return done, begun


@pytest.fixture(scope="module")
def alone():
    """Words that start a program where no other processes are seen.

    Without a port, `eldir rig off` stops every guardian that it sees: also those of other tests.
    """
    if os.geteuid() != 0 or shutil.which("unshare") is None:
        pytest.skip("only root can hide the guardians of other tests")
    with subprocess.Popen(
        ["unshare", "--pid", "--fork", "--mount-proc", "--kill-child", "sleep", "infinity"]
    ) as holder:
        children = Path(f"/proc/{holder.pid}/task/{holder.pid}/children")
        assert wait(lambda: children.read_text().strip() != "")
        child = children.read_text().strip()
        assert wait(lambda: "sleep" in Path(f"/proc/{child}/comm").read_text())
        yield ["nsenter", "--target", child, "--pid", "--mount", f"--wd={os.getcwd()}"]
        holder.kill()


def last_edge(board) -> float:
    return max(e.t for e in board.contact_events)


@pytest.fixture(autouse=True)
def no_other_records(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


BROKEN = {
    "broken YAML": lambda text: text.replace("channels:\n", "channels: [\n", 1) + "\n}}: : -",
    "ceiling of 95": lambda text: text.replace("max_temperature_c: 90", "max_temperature_c: 95"),
    "unknown entry": lambda text: text + "\nsurprise: 1\n",
    "no text": lambda text: "\x00\xff",
    "empty": lambda text: "",
    "another port": lambda text: text.replace("/dev/pts/", "/dev/pts/999"),
    "another kind": lambda text: text.replace("kind: lcus", "kind: gd32"),
    "a kind that is not installed": lambda text: text.replace("kind: lcus", "kind: toaster"),
    "missing": None,
    "a pipe": os.mkfifo,
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_rig_file_that_is_wrong(how, tmp_path, alone):
    """Damaged after the start: the records and the kernel's lock know the board."""
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        with heating_program(board, path, server=alone):
            text = path.read_text()
            path.unlink()
            if how == "a pipe":
                os.mkfifo(path)
            elif BROKEN[how] is not None:
                path.write_text(BROKEN[how](text), encoding="latin-1")
            done, begun = off("--rig", path, before=alone)
            assert not any(board.contacts) and last_edge(board) - begun < QUICK
        assert f"{board.port}: " in done.stdout and "all 4 channels are open" in done.stdout
        assert done.returncode == (1 if how == "another port" else 0), done.stdout + done.stderr
        assert read_stop(board.port)


def test_a_rig_file_that_is_wrong_and_nobody_drives(tmp_path):
    """A contact that is closed: the broken file still tells port and kind."""
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        path.write_text(path.read_text() + "\n]broken: [")
        board.set_coil(3, True)
        done, _ = off("--rig", path)
        assert done.returncode == 0 and not any(board.contacts), done.stdout + done.stderr
        assert "stopped by eldir rig off" in read_stop(board.port)


@pytest.mark.parametrize("words", [[], ["--port"]])
def test_without_a_rig_file(words, tmp_path, alone):
    """With no argument at all: every port that this computer drives."""
    with emulated("feedback") as one, emulated("lcus") as two:
        boards = [one, two] if not words else [one]
        paths = [
            rig_file(tmp_path / f"{i}.yaml", k, b.port)
            for i, (k, b) in enumerate([("feedback", one), ("lcus", two)])
        ]
        with heating_program(one, paths[0], server=alone), heating_program(two, paths[1], server=alone):
            done, begun = off(*words, *([one.port] if words else []), before=alone)
            assert done.returncode == 0, done.stdout + done.stderr
            for board in boards:
                assert not any(board.contacts) and last_edge(board) - begun < QUICK
                assert read_stop(board.port) != GUARDIAN_DIED
            if words:
                assert any(two.contacts), "another board is left alone"
                assert f"{two.port} is driven too" in done.stdout
            else:
                assert "every port that this computer drives" in done.stdout


def test_the_record_of_a_board_whose_programs_were_killed(tmp_path, alone):
    """Nobody holds the port, and nobody names it."""
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        with heating_program(board, path) as (program, guardian):
            program.send_signal(signal.SIGSTOP)
            os.kill(guardian, signal.SIGKILL)
            program.kill()
            done, _ = off(before=alone)
        assert done.returncode == 0 and not any(board.contacts), done.stdout + done.stderr


def test_a_port_of_which_nothing_is_known():
    """The kinds of board at the same time, because finding one out takes seconds of silence."""
    side_by_side(off_where_nothing_is_known, [(kind,) for kind in installed_kinds()], apart_s=0.8)


def off_where_nothing_is_known(kind: str) -> None:
    with emulated(kind) as board:
        close_contacts(board, range(1, 5))
        done, begun = off("--port", board.port)
        assert not any(board.contacts) and last_edge(board) - begun < QUICK, (
            "at once, whatever the proof takes"
        )
        took = time.monotonic() - begun
        print(f"\n| {kind}, not known | contacts open {last_edge(board) - begun:.2f} s | end {took:.2f} s |")
        assert done.returncode == 0, done.stdout + done.stderr
        channels = int(re.search(r"all (\d+) channels are open", done.stdout)[1])
        assert channels >= 4, "all that the board has"
        close_contacts(board, (2,))
        done, _ = off("--port", board.port, "--board", kind)
        assert done.returncode == 0 and not any(board.contacts)


def test_contacts_beyond_the_files_channels(tmp_path):
    """The file says 4 of 8 channels."""
    with emulated("lcus", 8) as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        board.set_coil(7, True)
        off("--rig", path)
        assert not any(board.contacts)


def test_what_is_not_proven_is_no_success(tmp_path):
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        board.set_coil(2, True)
        board.faults.deaf.add(2)
        done, _ = off("--rig", path)
        assert done.returncode == 1 and "cut the heating supply now" in done.stderr
        assert read_stop(board.port), "latched all the same"
    for name in ("/dev/null", tmp_path / "rig.yaml"):
        before = (tmp_path / "rig.yaml").read_bytes()
        done, _ = off("--port", name, "--board", "lcus")
        assert done.returncode == 1 and "it is not a serial port" in done.stdout
        assert (tmp_path / "rig.yaml").read_bytes() == before
    done, _ = off("--port", "/dev/no-such-port")
    assert done.returncode == 1 and "No such file" in done.stdout


def test_where_nothing_is_driven(alone):
    done, _ = off(before=alone)
    assert done.returncode == 1 and "no port is known" in done.stderr


def test_help_and_wrong_words_are_those_of_every_command(tmp_path):
    shown, _ = off("--help")
    assert shown.returncode == 0 and "Example" in shown.stdout and "--board" in shown.stdout
    for words in (["--nonsense"], ["--rig"], ["word"]):
        done, _ = off(*words)
        assert done.returncode == 2 and "eldir: " in done.stderr, words
    from tests.hardware.rigs_and_schedules import rig_text

    # Of another name than the rigs that other tests drive meanwhile: it would end their runs.
    (tmp_path / "rig.yaml").write_text(rig_text().replace("virtual bench", "bench of nobody"))
    done, _ = off("--rig", tmp_path / "rig.yaml")
    assert done.returncode == 1 and "no program drives the virtual rig" in done.stderr
    done, _ = off("--port", "/dev/null", "--board", "toaster")
    assert done.returncode == 1 and "unknown kind of relay board" in done.stderr


def test_a_module_beside_the_rig_file_does_not_stop_it(tmp_path):
    (tmp_path / "serial.py").write_text("raise SystemExit('ran')\n")
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        board.set_coil(1, True)
        done, _ = off("--rig", path, cwd=tmp_path)
        assert done.returncode == 0 and not any(board.contacts), done.stdout + done.stderr


@pytest.mark.parametrize(
    ("kind", "hangs"), each_once(installed_kinds(), ["nothing", "player", "guardian", "both"])
)
def test_how_long_it_takes(kind, hangs, tmp_path):
    """From the start of the process to the last contact, and to the end of the command."""
    with emulated(kind) as board:
        path = rig_file(tmp_path / "rig.yaml", kind, board.port)
        with heating_program(board, path) as (program, guardian):
            if hangs in ("guardian", "both"):
                os.kill(guardian, signal.SIGSTOP)
            if hangs in ("player", "both"):
                program.send_signal(signal.SIGSTOP)
            done, begun = off("--rig", path)
            ended = time.monotonic()
            program.send_signal(signal.SIGCONT)
            assert done.returncode == 0, done.stdout + done.stderr
            # Where its guardian hung or was slow, the program opens the contacts itself. It holds the port
            # then, and may be ended too. `eldir rig drive` tells that signal; this program does not.
            status = program.wait(15)
            assert status in (1, -signal.SIGTERM)
            assert status != 1 or "eldir rig off" in program.stderr.read(), "the true cause is told"
            opened = last_edge(board) - begun
            print(
                f"\n| {kind} | {hangs} hangs | contacts open {opened:.2f} s | end {ended - begun:.2f} s "
                f"| load {os.getloadavg()[0]:.1f} |"
            )
            # Four times the promised times: the machine may be busy with anything else.
            assert opened < 4 * (0.5 if hangs == "nothing" else 1.0)
            assert ended - begun < 4 * (0.5 if hangs == "nothing" else 1.0)
        assert not any(board.contacts)
        if hangs == "nothing":
            assert "eldir rig off" in read_stop(board.port)


def test_a_record_is_written_before_the_first_contact_closes_and_removed_after_a_good_end(tmp_path):
    with emulated("lcus") as board:
        latch_for_driving(board.port, "lcus", 4, "bench")
        (record,) = read_records()[0].values()
        assert (record.kind, record.channels, record.rig, record.stop) == ("lcus", 4, "bench", GUARDIAN_DIED)
        (file,) = (Path(os.environ["XDG_STATE_HOME"]) / "eldir").iterdir()
        assert json.loads(file.read_text())["format"] == "eldir-board/1"
        assert file.stat().st_mode & 0o777 == 0o600 and file.parent.stat().st_mode & 0o777 == 0o700


def test_the_tolerant_reading_agrees_with_the_strict_one(tmp_path):
    from eldir_hardware.rig._board_hints import read_board_hints
    from eldir_hardware.rig.template import real_rig

    for text in (
        real_rig("modbus", "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0"),
        'board: {kind: "lcus", "port": "/dev/tty USB", channels: 8}',
        "sensor: {kind: ina226,\n  port: /dev/s}\nboard: {kind: lcus, port: /dev/b, channels: 8}",
        "board: {kind: lcus, port: /dev/b, channels: 8}\nsensor:\n  kind: ina226\n  port: /dev/s\n",
        "{board: {kind: lcus, port: /dev/b, channels: 8}, sensor: {kind: ina226, port: /dev/s}}",
        "board:\n  port: '/dev/x#y'  # mine\n  kind: lcus\n  channels: 8\n",
    ):
        path = tmp_path / "rig.yaml"
        path.write_text(text)
        strict, told = yaml.safe_load(text)["board"], read_board_hints(path)
        assert told.ports == (strict["port"],) and strict["kind"] in told.kinds
        assert told.channels == strict["channels"] and told.sensor is ("sensor" in yaml.safe_load(text))
    path.write_text("sensor: {kind: ina226}\n  kind: lcus\n  port: /dev/b\n")
    assert read_board_hints(path).ports == ("/dev/b",), "a line is lost, but not the port"


def test_a_board_of_unknown_size_that_answered_too_late_once_is_not_taken_for_a_smaller_one(monkeypatch):
    with emulated("lcus", 4) as board:
        prove, asked = switching._prove_open, []

        def late(kind, port, count, guardian_proved, *, size_known):
            asked.append(count)
            if count > 1 and asked.count(count) == 1:
                raise SilentBoardError("it did not answer")
            prove(kind, port, count, guardian_proved, size_known=size_known)

        monkeypatch.setattr(switching, "_prove_open", late)
        outcome = switching.switch_off(OffTarget(board.port, [("lcus", None)]))
        assert outcome.proven and outcome.channels == 4


def test_no_contact_closes_behind_the_frames_of_off(tmp_path):
    """The guardian repeats the pulses of two channels when its signal and the frames arrive between them."""
    with emulated("modbus") as board:
        rig = rig_file(tmp_path / "rig.yaml", "modbus", board.port)
        with heating_program(board, rig) as (program, guardian):
            obey, struck = board.obey, []

            def off_behind_a_repeated_pulse(request: bytes) -> bytes:
                answer = obey(request)
                if not struck and request[:3] == b"\x01\x05\x02":
                    struck.append(len(board.contact_events))
                    os.kill(guardian, signal.SIGTERM)
                    obey(bytes.fromhex("010500FF0000FDFA"))
                return answer

            board.obey = off_behind_a_repeated_pulse
            program.communicate(timeout=20)
        assert [edge.closed for edge in board.contact_events[struck[0] :]] == [False, False]
