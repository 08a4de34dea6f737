"""Records of driven and stopped boards, one value at a time."""

import json
from pathlib import Path

import pytest

from eldir.errors import EldirError
from eldir_hardware.rig.board_identity import BoardIdentity
from eldir_hardware.safety import latch as module
from eldir_hardware.safety.latch import (
    LatchedError,
    find_record,
    latch,
    latch_for_driving,
    read_records,
    read_stop,
    require_unlatched,
    unlatch,
)
from eldir_hardware.safety.state_folder import StateFolder
from tests.hardware.emulated_rigs import emulated
from tests.raised import raises

GOOD = {
    "format": "eldir-board/1",
    "identity": {"name": "/dev/ttyUSB70", "marks": []},
    "port": "/dev/ttyUSB70",
    "stop": "too hot",
    "since": "2026-01-01T00:00:00+00:00",
    "kind": "lcus",
    "channels": 4,
    "rig": "bench",
    "opened": 12.5,
}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The state folder of this test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    found: Path = tmp_path / "state" / "eldir"
    found.mkdir(parents=True)
    return found


def write(path: Path, values: object) -> None:
    path.write_text(json.dumps(values))
    path.chmod(0o600)


@pytest.mark.parametrize(
    "change",
    [
        {"format": "eldir-board/2"},
        {"port": 1},
        {"stop": None},
        {"since": 2026},
        {"kind": 1},
        {"rig": 1},
        {"channels": "4"},
        {"opened": "12.5"},
        {"sensor_entries": "ina226"},
        {"identity": {"name": None, "marks": []}},
        {"identity": {"name": "/dev/ttyUSB70", "marks": [1]}},
        {"more": 1},
    ],
    ids=str,
)
def test_one_wrong_value_makes_a_record_wrong(change, folder):
    write(folder / "board-0.json", GOOD)
    assert list(read_records()[0]) == ["board-0.json"]
    write(folder / "board-0.json", GOOD | change)
    found, wrong = read_records()
    assert not found and wrong == {"board-0.json": f"{folder / 'board-0.json'} is damaged"}
    with pytest.raises(LatchedError):
        require_unlatched("/dev/ttyUSB71")


def test_values_that_may_be_missing(folder):
    write(
        folder / "board-0.json", GOOD | dict.fromkeys(("kind", "channels", "rig", "opened", "sensor_entries"))
    )
    assert not read_records()[1] and read_stop("/dev/ttyUSB70") == "too hot"


def test_files_that_are_being_written_or_have_just_gone_hide_no_other(folder, monkeypatch):
    write(folder / ".board-0.json.1f", "half a record")
    write(folder / "board-1.json", GOOD)
    write(folder / "board-2.json", "no record")
    found, wrong = read_records()
    assert list(found) == ["board-1.json"] and list(wrong) == ["board-2.json"]
    read = StateFolder.read

    def gone(self: StateFolder, name: str) -> bytes:
        if name == "board-1.json":
            raise FileNotFoundError(name)
        return read(self, name)

    monkeypatch.setattr(StateFolder, "read", gone)
    found, wrong = read_records()
    assert not found and list(wrong) == ["board-2.json"]


def test_a_record_is_complete_before_and_after_the_board_was_proven_open(monkeypatch):
    times = iter(["driven", "stopped", "opened", "stopped again"])
    monkeypatch.setattr(module, "_now", lambda: next(times))
    with emulated("lcus") as board:
        latch_for_driving(board.port, "lcus", 4, "bench")
        latch(board.port, "too \n hot")
        record = find_record(board.port)
        assert (record.stop, record.since, record.opened) == ("too hot", "stopped", None)
        latch(board.port, "later", opened=True)
        opened = find_record(board.port).opened
        assert opened is not None and find_record(board.port).since == "opened"
        latch(board.port, "later")
        assert find_record(board.port).opened == opened, "it was proven open once"
        assert find_record(board.port).stop == "too hot"


def test_a_port_that_nobody_drove_is_latched_unless_it_is_a_terminal_that_has_gone():
    """`eldir rig off --port` of a board that another program heats."""
    latch("/dev/ttyUSB70", "stopped")
    assert read_stop("/dev/ttyUSB70") == "stopped"
    latch("/dev/pts/99999", "stopped")
    assert read_stop("/dev/pts/99999") is None
    with emulated("lcus") as board:
        latch(board.port, "stopped")
        assert read_stop(board.port) == "stopped"


def test_a_reset_removes_no_record_of_another_board(folder):
    for name in ("/dev/ttyUSB70", "/dev/ttyUSB71"):
        latch(name, "stopped")
    (other,) = (n for n, r in read_records()[0].items() if r.port == "/dev/ttyUSB71")
    (folder / other).write_text("damaged")
    (folder / "board-x.json").write_text("damaged too")
    unlatch("/dev/ttyUSB70")
    assert sorted(p.name for p in folder.iterdir()) == sorted([other, "board-x.json"])


def test_a_record_that_cannot_be_removed(monkeypatch):
    latch("/dev/ttyUSB70", "stopped")

    def fails(self: StateFolder, name: str) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(StateFolder, "remove", fails)
    with raises(EldirError, "state.not-written", match="/dev/ttyUSB70: Read-only file system"):
        unlatch("/dev/ttyUSB70")


def test_records_of_terminals_that_have_gone_are_dropped_behind_damaged_ones(folder):
    write(folder / "board-0.json", "damaged")
    write(folder / "board-1.json", GOOD | {"identity": {"name": "/dev/pts/99999", "marks": ["pts:1"]}})
    with emulated("lcus") as board:
        latch_for_driving(board.port, "lcus", 4, "bench")
        assert [r.port for r in read_records()[0].values()] == [board.port]
    assert (folder / "board-0.json").exists()


def test_the_file_of_a_board_with_many_marks(folder, monkeypatch):
    """Always the same file with the same text."""
    marks = [f"link:/dev/serial/by-path/{i}" for i in range(20)]
    monkeypatch.setattr(module, "identify", lambda port: BoardIdentity(port, frozenset(marks)))
    latch_for_driving("/dev/ttyUSB70", "lcus", 4, "bench")
    (file,) = folder.iterdir()
    values = json.loads(file.read_text())
    assert values["identity"]["marks"] == sorted(marks)
    assert values["since"].endswith("+00:00") and "." not in values["since"]
