"""What identifies a board, and where it is now."""

import os
from pathlib import Path

import pytest

from eldir_hardware.rig import board_identity
from eldir_hardware.rig.board_identity import (
    BoardIdentity,
    identify,
    is_gone_pseudo_terminal,
    is_pseudo_terminal,
)
from tests.hardware.rig.pseudo_terminal import terminal

PORT = "/dev/null"


def test_the_places_where_the_kernel_describes_boards():
    assert (Path("/sys"), Path("/dev/serial/by-path")) == (board_identity._SYS, board_identity._LINKS)


def test_a_port_that_has_gone_is_known_by_its_link_and_not_by_its_number(tmp_path):
    link = tmp_path / "pci-1"
    link.symlink_to("/dev/ttyUSB70")
    assert identify(str(link)).marks == {f"link:{link}"} and identify(str(link)).name == "/dev/ttyUSB70"
    for name in ("/dev/ttyUSB70", "/dev/pts/99999"):
        assert identify(name) == BoardIdentity(name, frozenset())


def test_a_port_of_which_the_kernel_says_nothing_is_known_by_its_name_and_number(tmp_path):
    device = os.stat(PORT).st_rdev
    marks = {f"node:{PORT}@{os.major(device)}:{os.minor(device)}"}
    assert identify(PORT, sys=tmp_path, links=tmp_path).marks == marks


USB = "usb:1a86:7523:{}:00:"


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ({"path:1"}, {"path:1"}, True),
        ({"path:1", "link:/a"}, {"path:2", "link:/a"}, False),
        ({"path:1", USB.format(1)}, {"path:2", USB.format(1)}, True),
        ({"path:1", USB.format(1)}, {"path:1", USB.format(2)}, False),
        ({"path:1", USB.format(1)}, {"path:1"}, True),
        ({"link:/a"}, {"path:2", "link:/a"}, True),
        ({"link:/a"}, {"path:2", "link:/b"}, False),
        (set(), {"path:2"}, False),
    ],
    ids=lambda value: "+".join(sorted(value)) or "nothing" if isinstance(value, set) else str(value),
)
def test_what_one_device_proves_of_another(one, other, same):
    """Plugged in again it has another tty, perhaps another socket; a link alone is no proof."""
    one, other = (
        BoardIdentity("/dev/ttyUSB70", frozenset(one)),
        BoardIdentity("/dev/ttyUSB71", frozenset(other)),
    )
    assert one.is_same_device(other) is same and other.is_same_device(one) is same


def test_where_a_device_is_now(tmp_path, monkeypatch):
    """By its name, its links, or any tty: there where most of its marks are."""
    marks = {"/dev/null": {"path:1"}, "/dev/zero": {"path:2", USB.format(1)}, "/dev/full": {"path:3"}}
    monkeypatch.setattr(board_identity, "list_ports", lambda: ["/dev/full", "/dev/zero"])
    monkeypatch.setattr(
        board_identity, "identify", lambda port: BoardIdentity(port, frozenset(marks.get(port, set())))
    )

    def where(*own: str, name: str = "/dev/null") -> str | None:
        return board_identity.locate(BoardIdentity(name, frozenset(own)))

    assert where("path:1") == "/dev/null" and where("path:2") == "/dev/zero" and where("path:4") is None
    assert where("path:4", USB.format(1)) == "/dev/zero", "plugged into another socket"
    assert where("path:2", USB.format(2)) is None, "another board in its socket"
    marks["/dev/full"] = {"path:4", USB.format(1)}
    assert where("path:2", USB.format(1)) == "/dev/zero" and where("path:4", USB.format(1)) == "/dev/full"
    twin = BoardIdentity("/dev/full", frozenset({"path:4", USB.format(1)}))
    assert not BoardIdentity("/dev/zero", frozenset({"path:2", USB.format(1)})).is_same_device(twin), (
        "boards of one type may have the same number"
    )
    link = tmp_path / "by-path"
    assert where(f"link:{link}", name="/dev/ttyUSB70") == "/dev/ttyUSB70", "nothing else tells"
    link.symlink_to("/dev/null")
    assert where(f"link:{link}", name="/dev/ttyUSB70") == "/dev/null"


def test_serial_ports_that_have_hardware(tmp_path, monkeypatch):
    for name in ("ttyUSB0", "ttyS0", "tty1"):
        (tmp_path / name).mkdir()
    for name in ("ttyUSB0", "ttyS0"):
        (tmp_path / name / "device").mkdir()
    assert Path("/sys/class/tty") == board_identity._TTYS
    monkeypatch.setattr(board_identity, "_TTYS", tmp_path)
    assert sorted(board_identity.list_ports()) == ["/dev/ttyS0", "/dev/ttyUSB0"]
    monkeypatch.setattr(board_identity, "_TTYS", tmp_path / "none")
    assert board_identity.list_ports() == []


def test_pseudo_terminals():
    with terminal() as (_, name):
        assert is_pseudo_terminal(identify(name)) is True
        assert is_gone_pseudo_terminal(identify(name)) is False
    assert is_pseudo_terminal(identify(PORT)) is False
    gone = frozenset({"pts:/dev/pts/99999@1"})
    assert is_gone_pseudo_terminal(BoardIdentity("/dev/pts/99999", gone)) is True
    assert is_gone_pseudo_terminal(BoardIdentity("/dev/pts/99999", gone | {"link:/x"})) is False
    assert is_gone_pseudo_terminal(BoardIdentity("/dev/pts/99999", frozenset())) is False


def adapter(sys: Path, place: str, tty: str, **texts: str) -> set[str]:
    """Marks of a port with hardware there; files by their path from the tty's device, such as 'up/serial'."""
    device = sys / "devices" / place
    name = device / tty / tty
    name.mkdir(parents=True, exist_ok=True)
    rdev = os.stat(PORT).st_rdev
    char = sys / "dev" / "char"
    char.mkdir(parents=True, exist_ok=True)
    link = char / f"{os.major(rdev)}:{os.minor(rdev)}"
    link.unlink(missing_ok=True)
    link.symlink_to(name)
    if not (name / "device").is_symlink():
        (name / "device").symlink_to(device)
    for file, text in texts.items():
        folder = device if file.startswith("own_") else device.parent
        (folder / file.removeprefix("own_")).write_text(text + "\n")
    return set(identify(PORT, sys=sys, links=sys / "none").marks)


def test_a_port_of_the_main_board_is_known_by_its_place(tmp_path):
    assert adapter(tmp_path, "pnp0/00:01", "ttyS0") == {"path:devices/pnp0/00:01/ttyS0"}


def test_a_usb_adapter_by_the_place_of_its_socket_and_its_numbers(tmp_path):
    marks = adapter(
        tmp_path, "pci0/usb3/3-2/3-2.1/3-2.1:1.0", "ttyUSB0",
        idVendor="1a86", idProduct="7523", serial="S1", own_bInterfaceNumber="01", own_port_number="2",
    )  # fmt: skip
    assert marks == {"path:devices/pci0/usb/2/2.1:01:2", "usb:1a86:7523:S1:01:2"}


def test_texts_of_the_kernel_are_short_text_or_nothing(tmp_path):
    for data, text in ((b" a b \n", "a b"), (b"\xff", ""), (b"x" * 300, "x" * 200)):
        (tmp_path / "file").write_bytes(data)
        assert board_identity._read_text(tmp_path / "file") == text
    assert board_identity._read_text(tmp_path / "none") == ""
