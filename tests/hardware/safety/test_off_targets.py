"""Which ports `eldir rig off` switches off, and what their boards may be, from single hints."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from eldir.errors import InputError
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.rig._board_hints import BoardHints, read_board_hints
from eldir_hardware.rig.board_identity import BoardIdentity
from eldir_hardware.rig.port_holder import GuardedPort, get_lock
from eldir_hardware.safety import off_targets as module
from eldir_hardware.safety.latch import BoardRecord
from eldir_hardware.safety.off_targets import OffTarget, find_off_targets
from eldir_hardware.safety.state_folder import StateError


@pytest.fixture
def hints(monkeypatch):
    """What the file, the guardians and the records say."""

    hints = SimpleNamespace(told=BoardHints(), guarded=[], records={}, wrong={}, unreadable=None)

    def read_records(shared: Path):
        if hints.unreadable:
            raise hints.unreadable
        return hints.records, hints.wrong

    monkeypatch.setattr(module, "read_board_hints", lambda path: hints.told)
    monkeypatch.setattr(module, "list_guarded_ports", lambda: hints.guarded)
    monkeypatch.setattr(module, "read_records", read_records)
    return hints


def record(port: str, kind: str | None = "gd32", channels: int | None = 8, rig: str | None = None, marks=()):
    return BoardRecord(BoardIdentity(port, frozenset(marks)), port, "stopped", "2026", kind, channels, rig)


def guarded(process: int, port: str, named: str | None = None) -> GuardedPort:
    return GuardedPort(process, port, "lcus", 4, named or port, get_lock(port) or "00:05:70")


def found(*given) -> dict[str, list]:
    return {t.port: t.candidates for t in find_off_targets(*(given or (None, None, None)))[0]}


# What a board may be.


@pytest.mark.parametrize(
    ("hints", "candidates"),
    [
        ([("lcus", 4)], [("lcus", 4)]),
        ([("lcus", 1)], [("lcus", 1)]),
        ([("lcus", 8)], [("lcus", 8)]),
        ([("lcus", 9)], [("lcus", None)]),
        ([("lcus", 0)], [("lcus", None)]),
        ([("lcus", None)], [("lcus", None)]),
        ([("lcus", None), ("lcus", 4)], [("lcus", 4)]),
        ([("gd32", 4), ("lcus", None), ("lcus", 4)], [("gd32", 4), ("lcus", 4)]),
        ([("lcus", 4), ("lcus", None)], [("lcus", 4)]),
        ([("lcus", None), ("lcus", None)], [("lcus", None)]),
        ([("lcus", 4), ("lcus", 4)], [("lcus", 4)]),
        ([("lcus", 4), ("lcus", 8)], [("lcus", 4), ("lcus", 8)]),
        ([("lcus", None), ("lcus", 4), ("lcus", 4)], [("lcus", 4)]),
        ([("gd32", 4), ("lcus", 4)], [("gd32", 4), ("lcus", 4)]),
        ([(None, 4), (None, None), ("toaster", 4), ("toaster", None)], []),
    ],
    ids=str,
)
def test_what_a_board_may_be_is_the_first_hint_first_and_each_once(hints, candidates):
    target = OffTarget("/dev/x")
    for kind, channels in hints:
        target.add_candidate(kind, channels)
    assert target.candidates == candidates


def test_a_kind_whose_package_is_broken_is_no_candidate(monkeypatch):
    def broken(kind: str):
        raise InputError("cannot be loaded")

    monkeypatch.setattr(module, "get_board", broken)
    target = OffTarget("/dev/x")
    target.add_candidate("lcus", 4)
    target.add_candidate("lcus", None)
    assert target.candidates in ([], [("lcus", None)])
    with pytest.raises(InputError):
        find_off_targets(None, None, "lcus")
    assert installed_kinds()


# Which ports.


def test_nothing_is_driven(hints):
    targets, remarks = find_off_targets(None, None, None)
    assert targets == [] and remarks == ["switching off every port that this computer drives"]


def test_without_hints_every_guarded_and_recorded_port(hints):
    hints.guarded = [guarded(1, "/dev/null")]
    hints.records = {
        "a": record("/dev/ttyUSB70", "gd32", 8),
        "b": record("/dev/pts/99999", "gd32", 8, marks=["pts:/dev/pts/99999@1"]),  # it has gone
    }
    assert found() == {"/dev/null": [("lcus", 4)], "/dev/ttyUSB70": [("gd32", 8)]}


def test_a_named_port_alone_with_what_is_known_of_it(hints):
    hints.guarded = [guarded(1, "/dev/null"), guarded(2, "/dev/zero")]
    hints.records = {"a": record("/dev/null", "gd32", 8), "b": record("/dev/ttyUSB70")}
    assert found(None, "/dev/null", None) == {"/dev/null": [("lcus", 4), ("gd32", 8)]}
    assert found(None, "/dev/ttyUSB71", "lcus") == {"/dev/ttyUSB71": [("lcus", None)]}
    (target,), remarks = find_off_targets(None, "/dev/null", None)
    assert target.record is hints.records["a"]
    assert remarks == ["/dev/zero is driven too: eldir rig off --port /dev/zero"]


def test_a_link_names_the_same_port(hints, tmp_path):
    link = tmp_path / "board"
    link.symlink_to("/dev/null")
    hints.guarded = [guarded(1, "/dev/null")]
    targets, remarks = find_off_targets(None, str(link), None)
    assert [t.port for t in targets] == [str(link)] and remarks == []
    assert targets[0].candidates == [("lcus", 4)]


def test_other_guarded_ports_are_named_in_order(hints):
    hints.guarded = [guarded(i, f"/dev/ttyUSB{i}") for i in (79, 71, 75, 73, 77)]
    _, remarks = find_off_targets(None, "/dev/null", None)
    assert remarks == [f"/dev/ttyUSB{i} is driven too: eldir rig off --port /dev/ttyUSB{i}"
                       for i in (71, 73, 75, 77, 79)]  # fmt: skip


def test_the_file_s_port_and_those_through_which_its_rig_was_driven(hints):
    hints.told = BoardHints(("/dev/null",), ("real", "lcus"), 4, "bench", problem="a line is damaged")
    hints.wrong = {"board-1.json": "board-1.json is damaged"}
    hints.records = {
        "a": record("/dev/ttyUSB70", rig="bench"),
        "b": record("/dev/ttyUSB71", rig=None),
        "c": record("/dev/ttyUSB72", rig="another"),
    }
    targets, remarks = find_off_targets(Path("rig.yaml"), None, "numato")
    assert {t.port: t.candidates for t in targets} == {
        "/dev/null": [("numato", 4), ("lcus", 4)],
        "/dev/ttyUSB70": [("numato", 4), ("gd32", 8)],
    }
    assert remarks == ["a line is damaged", "board-1.json is damaged"]
    assert found(Path("rig.yaml"), "/dev/zero", None) == {"/dev/zero": [("lcus", 4)]}
    hints.told = BoardHints(("/dev/null",), ("lcus",), 4, None)  # its name cannot be read
    assert list(found(Path("rig.yaml"), None, None)) == [
        "/dev/null", "/dev/ttyUSB70", "/dev/ttyUSB71", "/dev/ttyUSB72",
    ]  # fmt: skip


def test_records_that_cannot_be_read_stop_nothing(hints):
    hints.unreadable = StateError("other users can write it")
    targets, remarks = find_off_targets(None, "/dev/null", "lcus")
    assert [t.port for t in targets] == ["/dev/null"] and remarks == ["other users can write it"]


def test_a_virtual_rig_has_the_port_through_which_it_is_driven_or_the_named_one(hints):
    hints.told = BoardHints(virtual=True, name="bench")
    hints.records = {"a": record("/dev/null", rig="bench"), "b": record("/dev/ttyUSB70", rig="bench")}
    assert find_off_targets(Path("rig.yaml"), None, None) == ([], []), "nothing drives it now"
    hints.guarded = [guarded(1, "/dev/null")]
    assert list(found(Path("rig.yaml"), None, None)) == ["/dev/null"]
    hints.records = {"a": record("/dev/null", rig="another")}
    assert found(Path("rig.yaml"), None, None) == {}
    assert list(found(Path("rig.yaml"), "/dev/null", None)) == ["/dev/null"]
    hints.told = BoardHints(("/dev/null",), virtual=True)
    assert list(found(Path("rig.yaml"), None, None)) == ["/dev/null"]


# What a file tells.


def told(tmp_path: Path, text: str | bytes) -> BoardHints:
    path = tmp_path / "rig.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_board_hints(path)


def test_the_entries_of_a_file(tmp_path):
    text = """
kind: real
name: "my bench"   # by the window
board:
  kind: lcus
  # port: /dev/old
  port: "/dev/my board"
  channels: 8
"""
    assert told(tmp_path, text) == BoardHints(("/dev/my board",), ("real", "lcus"), 8, "my bench")
    assert told(tmp_path, "kind: virtual\n").virtual
    assert not told(tmp_path, "kind: virtually\nboard: {kind: virtual}\n").virtual
    assert not told(tmp_path, "kind: real\n").sensor and told(tmp_path, "sensor: {kind: x}\n").sensor


@pytest.mark.parametrize(
    ("text", "ports"),
    [
        ("port: null", ()),
        ("port: ~", ()),
        ("port: /dev/a, port: /dev/b", ("/dev/a", "/dev/b")),
        ("port: /dev/a\nport: /dev/a", ("/dev/a",)),
        ("'port': '/dev/a b'", ("/dev/a b",)),
        ('{"port" : "/dev/a"}', ("/dev/a",)),
        ("port: /dev/a#b", ("/dev/a",)),
        ("support: /dev/a", ()),
        ("my-port: /dev/a", ()),
        ("\n".join(f"port: /dev/{i}" for i in range(20)), tuple(f"/dev/{i}" for i in range(8))),
    ],
)
def test_ports(tmp_path, text, ports):
    assert told(tmp_path, text).ports == ports


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("name: a", "a"),
        ("name: 'a b'", "a b"),
        ('name: "a"', "a"),
        ("name:\n", None),
        ("other: 1", None),
        ("name: a # b", "a"),
        ("board: {name: a}", None),
    ],
)
def test_names(tmp_path, text, name):
    assert told(tmp_path, text).name == name


@pytest.mark.parametrize(
    ("text", "channels"),
    [
        ("channels: 4", 4),
        ("channels: four", None),
        ("channels: 1234", None),
        ("channels: x\nchannels: 16", 16),
    ],
)
def test_channels(tmp_path, text, channels):
    assert told(tmp_path, text).channels == channels


def test_files_that_are_none(tmp_path):
    path = tmp_path / "rig.yaml"
    assert read_board_hints(path) == BoardHints(problem=f"cannot read {path}: No such file or directory")
    assert read_board_hints(tmp_path).problem == f"cannot read {tmp_path}: Is a directory"
    os.mkfifo(path)
    assert read_board_hints(path) == BoardHints(problem=f"{path} is not a file")
    assert read_board_hints(Path("a\0b")) == BoardHints(problem="cannot read a\0b: embedded null byte")


def test_long_files_and_files_that_are_no_text(tmp_path):
    assert told(tmp_path, b"port: /dev/\xff\n").ports == ("/dev/\ufffd",)
    beginning = "#" * 65_536
    assert told(tmp_path, beginning[:-14] + "\nport: /dev/abcdef").ports == ("/dev/ab",)
