"""Who holds a port, from a made-up /proc; how a port is written that others hold; what identifies a board."""

import errno
import fcntl
import os
import pty
import signal
import stat
import termios
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from eldir_hardware._serial_output import BlockedOutputError
from eldir_hardware.guardian import _connection as isolation
from eldir_hardware.rig import board_identity, port_holder
from eldir_hardware.rig.board_identity import (
    BoardIdentity,
    identify,
    is_gone_pseudo_terminal,
    is_pseudo_terminal,
)
from eldir_hardware.rig.port_holder import GuardedPort, Holder, find_holder, list_guarded_ports, signal_holder
from eldir_hardware.safety.off_frames import UnlockedPort
from tests.paths import PACKAGES


@pytest.fixture
def proc(tmp_path, monkeypatch):
    """An empty /proc, and the port of which it tells."""
    folder = tmp_path / "proc"
    folder.mkdir()
    monkeypatch.setattr(port_holder, "_PROC", folder)
    return folder


PORT = "/dev/null"
DEVICE = port_holder._lock_name(os.stat(PORT))


def locks(
    proc: Path, *processes: int, device: str = DEVICE, kind: str = "FLOCK", mode: str = "WRITE"
) -> None:
    lines = [f"{i}: {kind}  ADVISORY  {mode} {p} {device} 0 EOF" for i, p in enumerate(processes, 1)]
    (proc / "locks").write_text("\n".join(["1: POSIX", *lines, "2: -> FLOCK ADVISORY WRITE 7 x"]) + "\n")


def process(
    proc: Path, number: int, *, shows: str | None = "lock:\t1: FLOCK  ADVISORY  WRITE 1 {} 0 EOF", state="S",
    words: bytes = b"",
) -> None:  # fmt: skip
    folder = proc / str(number)
    (folder / "fdinfo").mkdir(parents=True)
    (folder / "fdinfo" / "0").write_text("pos:\t0\n")
    if shows is not None:
        (folder / "fdinfo" / "1").write_text(f"pos:\t0\n{shows.format(DEVICE)}\n")
    (folder / "stat").write_text(f"{number} (a) name) {state} 1 2 3\n")
    (folder / "cmdline").write_bytes(words)


def test_the_process_whose_file_bears_the_lock(proc):
    locks(proc, 11)
    process(proc, 11)
    assert find_holder(PORT) == Holder(11, os.getuid(), False)
    assert find_holder("/dev/zero") is None and find_holder("/dev/no-such-port") is None


@pytest.mark.parametrize(
    ("state", "stopped"), [("S", False), ("R", False), ("T", True), ("t", True), ("?", False)]
)
def test_whether_the_holder_is_suspended(proc, state, stopped):
    locks(proc, 11)
    process(proc, 11, state=state)
    assert find_holder(PORT).suspended is stopped


def test_a_holder_that_has_just_ended(proc, monkeypatch):
    locks(proc, 11)
    monkeypatch.setattr(port_holder, "_shows_lock", lambda *_: True)
    assert find_holder(PORT) == Holder(11, None, False)
    (proc / "11").mkdir()
    (proc / "11" / "stat").write_text("")
    assert find_holder(PORT) == Holder(11, os.getuid(), False)


@pytest.mark.parametrize(
    "shows",
    [
        None,
        "pos: FLOCK WRITE {}",
        "lock:\t1: POSIX  ADVISORY  WRITE 1 {} 0 EOF",
        "lock:\t1: FLOCK  ADVISORY  WRITE 1 {}0 0 EOF",
    ],
)
def test_a_process_without_the_lock_is_no_holder(proc, shows):
    locks(proc, 11)
    process(proc, 11, shows=shows)
    assert find_holder(PORT) is None


def test_locks_of_another_kind(proc):
    process(proc, 11)
    for more in ({"kind": "POSIX"}, {"mode": "READ"}, {"device": "00:00:1"}):
        locks(proc, 11, **more)
        assert find_holder(PORT) is None
    (proc / "locks").unlink()
    assert find_holder(PORT) is None


def test_a_lock_that_another_process_has_inherited(proc):
    locks(proc, 11)
    process(proc, 12, shows=None)
    process(proc, 13)
    (proc / "self").mkdir()
    assert find_holder(PORT).process == 13


def test_processes_whose_files_must_not_be_read(proc, monkeypatch):
    """They may be the holder: the first of them, unless another one is proven to be."""
    locks(proc, 11, 12, 13)
    for number in (11, 12, 13):
        process(proc, number)
    proven: dict[int, bool | None] = {11: None, 12: None, 13: None}
    monkeypatch.setattr(port_holder, "_shows_lock", lambda number, device: proven[number])
    assert find_holder(PORT).process == 11
    proven[13] = True
    assert find_holder(PORT).process == 13


def test_what_the_files_of_a_process_show(proc, monkeypatch):
    process(proc, 11)
    assert port_holder._shows_lock(11, DEVICE) is True
    assert port_holder._shows_lock(12, DEVICE) is False, "it has ended"

    def forbidden(self: Path):
        raise PermissionError

    monkeypatch.setattr(Path, "iterdir", forbidden)
    assert port_holder._shows_lock(11, DEVICE) is None


def test_guardians_by_their_words_and_their_lock(proc):
    locks(proc, 11, 12, 13, 14, 15, 16)
    words = [b"python", b"-I", b"eldir-guardian", b"3", PORT.encode(), b"lcus", b"4", b"/dev/link", b""]
    process(proc, 11, words=b"\0".join(words))
    process(proc, 12, words=b"\0".join([*words[:4], b"/dev/zero", *words[5:]]))
    process(proc, 13, words=b"\0".join([*words[:6], b"four", *words[7:]]))
    process(proc, 14, words=b"eldir-guardian\0003\0")
    process(proc, 15, words=b"\xff\0" + b"\0".join(words))
    found = GuardedPort(11, PORT, "lcus", 4, "/dev/link", DEVICE)
    assert list_guarded_ports() == [found, found._replace(process=15)]


def test_a_guardian_whose_port_was_unplugged_is_known_by_the_lock_that_it_still_holds(proc, tmp_path):
    """The name has gone, or is another device's by now."""
    port = tmp_path / "ttyUSB0"
    port.touch()
    handle, lock = os.open(port, os.O_RDWR), port_holder.get_lock(str(port))
    port.unlink()
    locks(proc, 11, device=lock)
    words = [b"eldir-guardian", b"3", str(port).encode(), b"lcus", b"4", b"/dev/link", b""]
    process(proc, 11, words=b"\0".join(words))
    assert list_guarded_ports() == []
    (proc / "11" / "fd").mkdir()
    (proc / "11" / "fd" / "5").symlink_to(f"/proc/{os.getpid()}/fd/{handle}")
    shown = os.readlink
    readlink = lambda path: shown(f"/proc/self/fd/{handle}") if str(path).endswith("11/fd/5") else shown(path)  # noqa: E731
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "readlink", readlink)
        assert list_guarded_ports() == [GuardedPort(11, str(port), "lcus", 4, "/dev/link", lock)]
        port.touch()
        assert list_guarded_ports() == [GuardedPort(11, str(port), "lcus", 4, "/dev/link", lock)]
    os.close(handle)


def test_signals(proc, monkeypatch):
    """Only to a process that shows the lock behind its pidfd; its file descriptor is closed."""
    me = os.getpid()
    process(proc, me)
    sent = []
    monkeypatch.setattr(signal, "pidfd_send_signal", lambda handle, number: sent.append(number))
    before = len(os.listdir("/proc/self/fd"))
    assert signal_holder(PORT, me, signal.SIGTERM) is True and sent == [signal.SIGTERM]
    assert signal_holder("/dev/zero", me, signal.SIGTERM) is False
    assert signal_holder("/dev/no-such-port", me, signal.SIGTERM) is False
    assert signal_holder(PORT, 2**22 - 1, signal.SIGTERM) is False

    def ended(handle: int, number: int) -> None:
        raise ProcessLookupError

    monkeypatch.setattr(signal, "pidfd_send_signal", ended)
    assert signal_holder(PORT, me, signal.SIGTERM) is False
    assert len(os.listdir("/proc/self/fd")) == before and sent == [signal.SIGTERM]


# The port that is written without its lock.


@contextmanager
def terminal():
    host, guest = pty.openpty()
    try:
        yield host, os.ttyname(guest)
    finally:
        os.close(host)
        os.close(guest)


def mode_of(port: str) -> list:
    handle = os.open(port, os.O_RDWR | os.O_NOCTTY)
    try:
        return termios.tcgetattr(handle)
    finally:
        os.close(handle)


@pytest.mark.parametrize("baud", [9600, 19200, 38400, 57600, 115200, 1234])
def test_the_bytes_and_the_mode_of_a_free_port(baud):
    """Raw: no byte is changed, added or echoed. An unknown speed is 9600."""
    with terminal() as (host, name):
        port = UnlockedPort(name)
        port.send(b"\n\r\x03\x11\xff", baud, is_held=False)
        assert os.read(host, 100) == b"\n\r\x03\x11\xff"
        found = mode_of(name)
        speed = getattr(termios, f"B{baud}", termios.B9600)
        assert found[:2] == [0, 0] and found[3] == 0 and found[4:6] == [speed, speed]
        assert found[2] & ~(termios.CBAUD | termios.CBAUDEX if hasattr(termios, "CBAUDEX") else 0o10017) == (
            termios.CS8 | termios.CREAD | termios.CLOCAL
        )
        port.close()


def test_the_mode_of_a_port_that_another_program_holds_is_left(monkeypatch):
    with terminal() as (host, name):
        before = mode_of(name)
        port = UnlockedPort(name)
        assert os.get_blocking(port._handle) is False
        assert fcntl.fcntl(port._handle, fcntl.F_GETFD) == fcntl.FD_CLOEXEC
        port.send(b"off", 115200, is_held=True)
        before[0] &= ~(termios.IXON | termios.IXOFF | termios.IXANY)  # any byte of a board could stop it
        assert mode_of(name) == before and os.read(host, 100) == b"off"
        port.send(b"", 9600, is_held=False)
        calls = []
        monkeypatch.setattr(termios, "tcsetattr", lambda *_: calls.append("set"))
        port.send(b"", 9600, is_held=False)
        assert calls == [], "it is as it should be already"
        port.close()
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(port._handle)


def test_a_port_that_takes_few_bytes_at_a_time_or_none(monkeypatch):
    """It is tried for its time on the wire and 0.2 s more, then said."""
    written: list[bytes] = []

    def write(handle: int, data: bytes) -> int:
        if len(written) < 3:
            written.append(data[:2])
            return 2
        raise BlockingIOError

    with terminal() as (_, name):
        port = UnlockedPort(name)
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", write)
            port.send(b"abcdef", 9600, is_held=True)
            assert written == [b"ab", b"cd", b"ef"]
            begun = time.monotonic()
            with pytest.raises(BlockedOutputError, match="accepts no more bytes"):
                port.send(bytes(96), 9600, is_held=True)
            assert 0.3 <= time.monotonic() - begun < 0.8
        port.close()


def test_a_port_that_is_lost_while_it_is_written(monkeypatch):
    """The proof will tell."""
    with terminal() as (_, name):
        port = UnlockedPort(name)

        def lost(*_: object) -> int:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

        with monkeypatch.context() as patch:
            patch.setattr(os, "write", lost)
            port.send(b"abc", 9600, is_held=True)
        port.close()


def test_files_that_are_no_serial_ports(tmp_path):
    before = len(os.listdir("/proc/self/fd"))
    for name in (PORT, str(tmp_path)):
        with pytest.raises(OSError, match="it is not a serial port") as caught:
            UnlockedPort(name)
        assert caught.value.errno == errno.ENOTTY
    assert len(os.listdir("/proc/self/fd")) == before


def test_whether_a_port_is_free():
    with terminal() as (_, name):
        port = UnlockedPort(name)
        assert port.is_free() is True
        other = os.open(name, os.O_RDWR | os.O_NOCTTY)
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)  # it was given back
        assert port.is_free() is False
        os.close(other)
        assert port.is_free() is True
        port.close()


# What identifies a board.


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


# What the guardian takes from this program.


def test_the_few_variables_that_the_guardian_needs(monkeypatch, tmp_path):
    here, others = tmp_path / "here", tmp_path / "others"
    for folder, mode in ((here, 0o755), (others, 0o777)):
        folder.mkdir()
        folder.chmod(mode)
    kept = {
        "HOME": "h",
        "LANG": "l",
        "LOGNAME": "n",
        "PATH": "p",
        "TZ": "z",
        "USER": "u",
        "XDG_STATE_HOME": "x",
    }
    given = kept | {"LC_ALL": "C", "PYTHONPATH": "/evil", "LD_PRELOAD": "/evil.so"}
    monkeypatch.setattr(os, "environ", given)
    own = {"PYDANTIC_DISABLE_PLUGINS": "__all__", "OPENBLAS_NUM_THREADS": "1"}
    assert isolation.clean_environment() == kept | {"LC_ALL": "C"} | own
    given["LD_LIBRARY_PATH"] = f"/usr:{others}:relative:{here}:/etc/passwd"
    assert isolation.clean_environment()["LD_LIBRARY_PATH"] == f"/usr:{here}"
    monkeypatch.chdir(here)
    assert isolation.clean_environment()["LD_LIBRARY_PATH"] == "/usr"
    given["LD_LIBRARY_PATH"] = "relative"
    assert "LD_LIBRARY_PATH" not in isolation.clean_environment()


def test_the_folders_from_which_the_guardian_imports(monkeypatch, tmp_path):
    here, others, file = tmp_path / "here", tmp_path / "others", tmp_path / "file"
    here.mkdir()
    others.mkdir()
    others.chmod(0o777)
    file.touch()
    homes = [str(PACKAGES[name].parent) for name in ("eldir", "eldir_hardware")]
    monkeypatch.setattr(
        isolation, "sys", SimpleNamespace(path=["", "/usr", str(here), str(others), str(file), "/usr"])
    )
    assert isolation.import_path() == ["/usr", str(here), *homes]
    monkeypatch.chdir(here)
    assert isolation.import_path() == ["/usr", *homes]
    monkeypatch.chdir(homes[0])
    assert isolation.import_path() == ["/usr", str(here), *homes], "the program's own folder stays"
    assert not stat.S_IWOTH & os.stat(homes[0]).st_mode
