"""Latched stops: one for each board, in a folder that nobody else can write."""

import json
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.errors import EldirError
from eldir_hardware.rig.board_identity import BoardIdentity, identify
from eldir_hardware.safety.latch import (
    GUARDIAN_DIED,
    LatchedError,
    end_driving,
    find_record,
    latch,
    latch_for_driving,
    read_records,
    read_stop,
    require_not_stopped,
    require_unlatched,
    unlatch,
)
from eldir_hardware.safety.state_folder import StateError, open_state_folder
from tests.hardware.emulated_rigs import emulated
from tests.paths import ROOT
from tests.raised import raises

pytestmark = pytest.mark.usefixtures("state_folder")
NOWHERE = Path("/no/shared/folder")


def drive(port: object) -> None:
    latch_for_driving(str(port), "lcus", 4, "bench")


def test_a_latch_belongs_to_the_board_behind_a_link(tmp_path):
    """USB renumbers: the same link, another tty. Links of another board and its tty are not latched."""
    link, other = tmp_path / "by-path-1", tmp_path / "by-path-2"
    with emulated("lcus") as first, emulated("lcus") as second:
        link.symlink_to(first.port)
        other.symlink_to(second.port)
        drive(link)
        latch(str(link), "too hot")
        with raises(LatchedError, "stop.latched", match="too hot"):
            require_unlatched(first.port)
        require_unlatched(str(other))
        link.unlink()
        other.unlink()
        link.symlink_to(second.port)
        other.symlink_to(first.port)
        with raises(LatchedError, "stop.latched", match="too hot"):
            require_unlatched(str(link))
        with pytest.raises(
            EldirError, match=f"{link} names {second.port} now, and the run drove {first.port}"
        ):
            unlatch(str(link))
        require_unlatched(second.port)
        latch(first.port, "stopped by eldir rig off", opened=True)
        unlatch(str(link))
        require_unlatched(str(link))
        require_unlatched(str(other))


def usb(sys: Path, port: str, place: str, serial: str | None, interface: str = "00") -> None:
    """A USB serial adapter as /sys describes it, such as at 0000:00:14.0/usb1/1-2."""
    rdev = os.stat(port).st_rdev
    device = sys / "devices" / "pci0000:00" / place
    tty = device / f"{device.name}:1.0" / "ttyUSB0"
    for folder in (sys / "dev" / "char", tty / "tty" / "ttyUSB0"):
        folder.mkdir(parents=True, exist_ok=True)
    (device / "idVendor").write_text("1a86\n")
    (device / "idProduct").write_text("7523\n")
    if serial:
        (device / "serial").write_text(serial + "\n")
    (tty.parent / "bInterfaceNumber").write_text(interface + "\n")
    (tty / "tty" / "ttyUSB0" / "device").symlink_to(tty)
    link = sys / "dev" / "char" / f"{os.major(rdev)}:{os.minor(rdev)}"
    link.unlink(missing_ok=True)
    link.symlink_to(tty / "tty" / "ttyUSB0")


def test_a_board_is_known_by_its_socket_or_its_serial_number(tmp_path):
    """After a reboot the buses and ttys may have other numbers."""
    with emulated("lcus") as first, emulated("lcus") as second:

        def marks(sys: str, port: str) -> frozenset[str]:
            found = identify(port, sys=tmp_path / sys, links=tmp_path / "none").marks
            return frozenset(m for m in found if not m.startswith("pts:"))

        usb(tmp_path / "a", first.port, "0000:00:14.0/usb1/1-2", "S1")
        usb(tmp_path / "b", second.port, "0000:00:14.0/usb3/3-2", "S1")
        usb(tmp_path / "c", second.port, "0000:00:14.0/usb1/1-4", "S1")
        usb(tmp_path / "d", second.port, "0000:00:14.0/usb1/1-4", None)
        usb(tmp_path / "e", second.port, "0000:00:14.0/usb1/1-4", "S1", interface="01")
        usb(tmp_path / "f", second.port, "0000:00:14.0/usb1/1-2.1", None)
        board = marks("a", first.port)
        assert len(board) == 2
        assert marks("b", second.port) == board, "the bus has another number"
        assert marks("c", second.port) & board, "another socket, the same serial number"
        assert not marks("d", second.port) & board, "another board of the same type"
        assert not marks("e", second.port) & board, "the second port of the adapter"
        assert not marks("f", second.port) & board, "behind a hub in the same socket"


def test_links_by_path_are_found_whatever_name_was_used(tmp_path):
    with emulated("lcus") as board:
        (tmp_path / "pci-1").symlink_to(board.port)
        (tmp_path / "pci-2").symlink_to("/dev/null")
        assert f"link:{tmp_path}/pci-1" in identify(board.port, links=tmp_path).marks
        assert f"link:{tmp_path}/pci-2" not in identify(board.port, links=tmp_path).marks


def test_a_board_without_marks_is_known_by_its_name():
    """The port has gone, or nothing else is known of it."""
    with_marks = BoardIdentity("/dev/ttyUSB0", frozenset({"path:x"}))
    assert BoardIdentity("/dev/ttyUSB0", frozenset()).is_same_board(with_marks)
    assert not BoardIdentity("/dev/ttyUSB1", frozenset()).is_same_board(with_marks)
    assert not BoardIdentity("/dev/ttyUSB0", frozenset({"path:y"})).is_same_board(with_marks)


def test_a_pseudo_terminal_that_has_gone_blocks_no_other():
    with emulated("lcus") as board:
        port = board.port
        drive(port)
    latch(port, "the port was lost")
    assert read_stop(port) == "the port was lost", "as long as no other has its number"
    with emulated("lcus") as board:
        assert board.port == port
        require_unlatched(port)
        drive(port)
        assert len(read_records()[0]) == 1, "the old record is dropped"


def test_a_record_is_what_its_schema_says(state_folder):
    schema = json.loads((ROOT / "docs" / "schemas" / "board.schema.json").read_text())
    with emulated("lcus") as board:
        drive(board.port)
        latch(board.port, "too hot", opened=True)
        (file,) = state_folder.iterdir()
        jsonschema.validate(json.loads(file.read_text()), schema)


def test_the_first_reason_stays():
    with emulated("lcus") as board:
        drive(board.port)
        assert read_stop(board.port) == GUARDIAN_DIED
        latch(board.port, "the board is silent")
        latch(board.port, "stopped by eldir rig off", opened=True)
        record = find_record(board.port)
        assert record.stop == "the board is silent" and record.kind == "lcus" and record.opened > 0


def plant(path: Path, how: str, tmp_path: Path) -> None:
    path.unlink()
    match how:
        case "a pipe":
            os.mkfifo(path)
        case "a dangling link":
            path.symlink_to(tmp_path / "nowhere")
        case "a link":
            (tmp_path / "elsewhere").write_text("{}")
            path.symlink_to(tmp_path / "elsewhere")
        case "a folder":
            path.mkdir()
        case "a device":
            os.mknod(path, 0o600 | 0o020000, os.makedev(1, 5))  # /dev/zero
        case "writable by others":
            path.write_text("{}")
            path.chmod(0o666)
        case "of another user":
            path.write_text("{}")
            os.chown(path, 12345, 12345)
        case "too long":
            path.write_text(" " * 100_000)
        case "cut short":
            path.write_text('{"format": "eldir-bo')
        case "deep":
            path.write_text("[" * 60_000)
        case "another format":
            path.write_text('{"format": "eldir-board/9"}')
        case "empty":
            path.write_text("")


PLANTED = [
    "a pipe", "a dangling link", "a link", "a folder", "a device", "writable by others", "of another user",
    "too long", "cut short", "deep", "another format", "empty",
]  # fmt: skip


@pytest.mark.parametrize("how", PLANTED)
def test_anything_wrong_with_a_latch_counts_as_latched(how, state_folder, tmp_path):
    if os.geteuid() != 0 and how in ("a device", "of another user"):
        pytest.skip("only root can make it")
    with emulated("lcus") as board:
        drive(board.port)
        (file,) = state_folder.iterdir()
        plant(file, how, tmp_path)
        with pytest.raises(LatchedError, match=rf"counts as stopped: .*{file.name}"):
            require_unlatched(board.port)
        latch(board.port, "now")  # replaces it, and follows no link
        assert not (tmp_path / "nowhere").exists()
        if how == "a link":
            assert (tmp_path / "elsewhere").read_text() == "{}"
        if how == "a folder":
            file.rmdir()
        unlatch(board.port)
        require_unlatched(board.port)


@given(data=st.binary(max_size=200))
def test_no_bytes_of_a_record_raise_another_error(data):
    with emulated("lcus") as board, open_state_folder() as state:
        state.write("board-0.json", data)
        with pytest.raises(LatchedError):
            require_unlatched(board.port)
        state.remove("board-0.json")


@settings(max_examples=30)
@given(
    st.dictionaries(
        st.sampled_from(["port", "stop", "since", "kind", "channels", "rig", "opened", "identity", "more"]),
        st.none() | st.integers() | st.text(max_size=3) | st.lists(st.integers(), max_size=2),
    )
)
def test_no_values_of_a_record_raise_another_error(values):
    good = {"identity": {"name": "/dev/x", "marks": []}, "port": "/dev/x", "stop": "s", "since": "t"}
    with emulated("lcus") as board, open_state_folder() as state:
        state.write("board-0.json", json.dumps({"format": "eldir-board/1"} | good | values).encode())
        found, wrong = read_records()
        assert len(found) + len(wrong) == 1
        if wrong:
            with pytest.raises(LatchedError):
                require_unlatched(board.port)
        state.remove("board-0.json")


def test_two_programs_that_latch_a_board_at_once_lose_nothing():
    """`eldir rig off` latches its reason while the guardian latches its proof."""
    with emulated("lcus") as board, ThreadPoolExecutor(2) as programs:
        for _ in range(50):
            drive(board.port)
            together = Barrier(2)

            def latch_together(why, opened, together=together):
                together.wait()
                return latch(board.port, why, opened=opened)

            done = [programs.submit(latch_together, *which) for which in (("off", False), ("ended", True))]
            assert [one.result() for one in done] == [None, None]
            record = find_record(board.port)
            assert record.opened is not None and record.stop in ("off", "ended")
            unlatch(board.port)


def test_a_program_that_stands_still_while_it_writes_holds_up_no_stop(state_folder):
    with emulated("lcus") as board:
        drive(board.port)
        with open_state_folder(exclusive=True):
            begun = time.monotonic()
            assert latch(board.port, "off") is None
            assert time.monotonic() - begun < 1.0
        assert read_stop(board.port) == "off"


def test_a_full_disk_keeps_the_record_and_refuses_the_start(state_folder, monkeypatch):
    import resource

    with emulated("lcus") as board:
        drive(board.port)
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1, limits[1]))
        try:
            assert "File too large" in latch(board.port, "too hot")
            assert read_stop(board.port) == GUARDIAN_DIED and len(list(state_folder.iterdir())) == 1
            with raises(EldirError, "state.not-written"):
                drive(board.port)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert read_stop(board.port) == GUARDIAN_DIED


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_a_folder_that_others_can_write_is_refused(mode, state_folder):
    state_folder.mkdir(parents=True)
    state_folder.chmod(mode)
    with emulated("lcus") as board:
        with pytest.raises(LatchedError, match=rf"other users can write .*chmod 700 {state_folder}"):
            require_unlatched(board.port)
        with raises(EldirError, "state.not-written", match="other users can write"):
            drive(board.port)
        assert "other users" in latch(board.port, "never fails")


def test_a_folder_that_is_a_link_or_has_an_open_parent_is_refused(state_folder, tmp_path):
    (tmp_path / "mine").mkdir()
    state_folder.parent.mkdir()
    state_folder.symlink_to(tmp_path / "mine")
    with raises(StateError, "state.no-access"), open_state_folder(NOWHERE):
        pass
    state_folder.unlink()
    state_folder.parent.chmod(0o777)
    with raises(StateError, "state.open-folder", match="by every user"), open_state_folder(NOWHERE):
        pass


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes a shared folder")
def test_a_shared_folder_must_be_what_an_administrator_makes(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    for owner, mode, sound in (
        (0, 0o2770, True),
        (0, 0o755, False),
        (0, 0o2777, False),
        (12345, 0o2770, False),
    ):
        shared.chmod(mode)
        os.chown(shared, owner, 4321)
        shared.chmod(mode)
        if sound:
            with open_state_folder(shared) as state:
                assert state.path == shared
        else:
            with raises(StateError, "state.open-folder", match="safe to share"), open_state_folder(shared):
                pass


def test_a_good_end_leaves_the_stop_that_came_meanwhile():
    """Such as another user's `eldir rig off`, which cannot signal this user's guardian."""
    with emulated("lcus") as board:
        drive(board.port)
        end_driving(board.port)
        assert read_stop(board.port) is None
        drive(board.port)
        latch(board.port, "stopped by eldir rig off")
        end_driving(board.port)
        assert read_stop(board.port) == "stopped by eldir rig off"
        end_driving("/dev/null")
        unlatch(board.port)
        assert read_stop(board.port) is None


def test_a_board_that_is_driven_is_stopped_through_the_shared_folder(state_folder):
    """The folder of a user tells nothing of the others: there it is not looked at."""
    with emulated("lcus") as board:
        require_not_stopped(board.port)
        drive(board.port)
        require_not_stopped(board.port)
        latch(board.port, "anna stopped it")
        require_not_stopped(board.port, NOWHERE)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes a shared folder")
def test_a_board_that_is_driven_is_stopped_by_another_member_of_its_group(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o2770)
    with emulated("lcus") as board:
        latch_for_driving(board.port, "lcus", 4, "bench", shared)
        require_not_stopped(board.port, shared)
        latch(board.port, "anna stopped it", shared=shared)
        with raises(LatchedError, "stop.latched", match="anna stopped it; look at the rig"):
            require_not_stopped(board.port, shared)
        end_driving(board.port, shared)
        assert read_stop(board.port, shared) == "anna stopped it"
