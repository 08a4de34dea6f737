"""A relay board from another package: found by its entry point, with no change here."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from eldir.errors import InputError
from eldir_hardware.clock import WallClock
from eldir_hardware.relay.errors import ContactError
from eldir_hardware.relay.registration import GROUP, get_board, installed_kinds
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_driver, get_emulator
from eldir_hardware.safety.compatibility import with_digests
from tests.hardware.emulated_rigs import rig_file
from tests.hardware.relay.relay_answers import CHECKSUM, believed_wrongly
from tests.hardware.rigs_and_schedules import SCHEDULE, rig_text
from tests.paths import ROOT
from tests.raised import raises

TOY = (ROOT / "examples" / "own_relay_board.py").read_text()


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a package as `pip install` leaves it; on the path of this program and its children."""
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "toy_board.py").write_text(TOY)
    (folder / "raising_board.py").write_text("1 / 0\n")
    (folder / "exiting_board.py").write_text("raise SystemExit(3)\n")
    info = folder / "toy_board-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-board\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        f"[{GROUP}]\ntoy = toy_board:BOARD\nbroken = no_such_module:BOARD\nwrong = toy_board:ToyBoard\n"
        "raises = raising_board:BOARD\nexits = exiting_board:BOARD\nlcus = raising_board:BOARD\n"
    )
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    monkeypatch.delitem(sys.modules, "toy_board", raising=False)
    return folder


def eldir(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from eldir_app.main import main; main()", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_commands_know_it(installed: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    made = eldir("rig", "new", "--board", "toy", "--port", "/dev/ttyUSB7", "--out", rig)
    assert made.returncode == 0, made.stderr
    assert Rig.load(rig).board.kind == "toy"
    assert "\n  retriggerable:" not in rig.read_text(), "it does not time pulses"
    examined = eldir("rig", "doctor", "--rig", rig, "--json")
    subjects = {f["subject"]: f for f in json.loads(examined.stdout)}
    assert "/dev/ttyUSB7" in subjects["port"]["text"], "as of any real board that is not there"


def test_it_drives_through_real_bytes(installed: Path, tmp_path: Path) -> None:
    """`eldir rig emulate` offers it; the guardian process opens it and heats one short pulse."""
    command = [sys.executable, "-c", "from eldir_app.main import main; main()", "rig", "emulate"]
    trace = tmp_path / "edges.jsonl"
    with subprocess.Popen(
        [*command, "--board", "toy", "--trace", str(trace)], stdout=subprocess.PIPE, text=True
    ) as emulator:
        try:
            port = emulator.stdout.readline().strip()  # type: ignore[union-attr]
            rig = rig_file(tmp_path / "rig.yaml", "toy", port)
            examined = eldir("rig", "doctor", "--rig", rig)
            assert "board: toy, all open" in examined.stdout, examined.stdout + examined.stderr
            events = tuple(sorted(replace(e, t_s=0.0 if e.on else 0.5) for e in SCHEDULE.events))
            schedule = tmp_path / "schedule.json"
            short = replace(
                SCHEDULE, period_s=9.0, settle_s=0.0, conditioning_cycles=0, cycles=1, events=events
            )
            with_digests(short, Rig.load(rig)).save(schedule)
            driven = eldir("rig", "drive", schedule, "--rig", rig, "--log", tmp_path / "log.mcap")
            assert driven.returncode == 0, driven.stderr
        finally:
            emulator.send_signal(signal.SIGTERM)
            assert emulator.wait(10) == 0
    edges = [json.loads(line) for line in trace.read_text().splitlines()]
    channels = {e.channel for e in events}
    assert {e["channel"] for e in edges} == channels
    for channel in channels:
        assert [e["closed"] for e in edges if e["channel"] == channel] == [True, False]


def test_a_dry_run_emulates_it(installed: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig_text(board="toy").replace("camera: {kind: virtual, rate_hz: 10}\n", ""))
    short = replace(SCHEDULE, conditioning_cycles=0, cycles=1)
    with_digests(short, Rig.load(rig)).save(tmp_path / "schedule.json")
    driven = eldir(
        "rig", "drive", tmp_path / "schedule.json", "--rig", rig, "--log", tmp_path / "log.mcap", "--dry-run"
    )
    assert driven.returncode == 0, driven.stderr


def test_the_guardian_finds_what_only_its_parent_has_on_its_path(
    installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as a board in the folder of a script, which is on the path of the script alone."""
    from eldir_hardware.guardian.client import Guardian

    monkeypatch.delenv("PYTHONPATH")
    assert str(installed) not in os.environ.get("PYTHONPATH", "")
    board = get_emulator("toy")(4, WallClock())
    rig = Rig.load(rig_file(tmp_path / "rig.yaml", "toy", board.start()))
    with Guardian(rig) as bank, bank.armed():
        assert bank.process
    board.close()


def test_the_conformance_checks_hold_for_it(installed: Path) -> None:
    assert "toy" in installed_kinds() and get_driver("toy").__name__ == "ToyBoard"
    assert get_board("toy").max_channels == 9
    assert believed_wrongly("toy", 2000) <= CHECKSUM


TESTS_OF_ALL_BOARDS = [
    "test_relays.py",
    "test_board_interface.py",
    "test_board_commands.py",
    "test_all_off.py",
]


@pytest.mark.realtime
def test_the_tests_of_all_boards_run_on_it(installed: Path) -> None:
    """Those that docs/how-to/add-a-board.md names: with the board installed and nothing else done."""
    points = installed / "toy_board-1.0.dist-info" / "entry_points.txt"
    points.write_text(f"[{GROUP}]\ntoy = toy_board:BOARD\n")
    files = [str(ROOT / "tests" / "hardware" / "relay" / name) for name in TESTS_OF_ALL_BOARDS]
    words = ["toy or known_everywhere or time_pulses", "-p", "no:cacheprovider", "-q", "--no-header", "-rA"]
    command = [sys.executable, "-m", "pytest", *files, "-k", *words]
    path = os.pathsep.join([str(installed), str(ROOT)])
    places = os.environ | {"PYTHONPATH": path}
    ran = subprocess.run(command, cwd=ROOT, env=places, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout[-4000:]
    for name in TESTS_OF_ALL_BOARDS:
        assert f"{name}::" in ran.stdout, f"none of {name} runs on it"


def test_a_closed_relay_beyond_its_channels_is_seen(installed: Path) -> None:
    emulated = get_emulator("toy")(8, WallClock())
    board = get_driver("toy")(emulated.start(), 4, WallClock())
    try:
        emulated.set_coil(7, True)
        with pytest.raises(ContactError, match="contact 7 is closed, but the rig file has 4 channels"):
            board.read_states()
        board.all_off()
        assert emulated.contacts == (False,) * 8, "all-off opens it too"
    finally:
        board.close()
        emulated.close()


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("broken", "broken .*no_such_module:BOARD.*ModuleNotFoundError"),
        ("wrong", "relay board wrong .*toy_board:ToyBoard; expected .*registration.Board"),
        ("raises", "raises .*raising_board:BOARD.*ZeroDivisionError"),
        ("exits", "exits .*exiting_board:BOARD.*SystemExit"),
    ],
)
def test_a_kind_that_is_broken_is_named(installed: Path, kind: str, said: str) -> None:
    with raises(InputError, "package.broken", match=said):
        get_board(kind)


def test_a_kind_that_is_not_there_is_named(installed: Path) -> None:
    said = "expected .*lcus.*toy.*; found 'nonsense'"
    with raises(InputError, "input.unknown-name", "kind of relay board", match=said):
        get_board("nonsense")


def test_no_package_replaces_a_board_of_eldir(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rig of this kind must still be switched off, wherever the package stands on the path."""
    monkeypatch.setattr(sys, "path", [*sys.path[1:], str(installed)])
    assert get_driver("lcus").__module__ == "eldir_hardware.relay.lcus"


def test_a_rig_is_switched_off_beside_broken_packages(installed: Path, tmp_path: Path) -> None:
    board = get_emulator("lcus")(4, WallClock())
    rig = rig_file(tmp_path / "rig.yaml", "lcus", board.start())
    with (installed / "toy_board-1.0.dist-info" / "entry_points.txt").open("a") as points:
        points.write("[eldir.commands]\nbroken = raising_board:command\n")
    try:
        stopped = eldir("rig", "off", "--rig", rig)
        unknown = eldir("rig", "off", "--port", board.port)
        reset = eldir("rig", "reset", "--rig", rig)
        listed = eldir("--help")
    finally:
        board.close()
    for done in (stopped, unknown):
        assert done.returncode == 0, done.stderr
        assert "all 4 channels are open by the board's report" in done.stdout and not done.stderr
    assert reset.returncode == 0 and not reset.stderr, "another package's command is not loaded"
    assert "the command broken cannot be loaded from raising_board:command" in listed.stderr


def test_an_emulator_that_is_not_there_is_named(installed: Path) -> None:
    code = (installed / "toy_board.py").read_text().replace(":EmulatedToy", ":Nobody")
    (installed / "toy_board.py").write_text(code)
    assert get_driver("toy")
    with raises(InputError, "package.broken", match="toy .*toy_board:Nobody"):
        get_emulator("toy")


def test_too_many_channels_for_it(installed: Path) -> None:
    told = eldir("rig", "emulate", "--board", "toy", "--channels", "10")
    assert told.returncode == 2 and "a board of kind toy has at most 9" in told.stderr
